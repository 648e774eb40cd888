-- What the pages read. A log has one row in `newest`, a vehicle one in `current`.
-- A vehicle has rows for each pair of robot file and model version. Its current pair is the last one with a verdict,
-- or else the last one with flights, so that a run in progress hides no verdict.
CREATE TABLE newest AS
  SELECT log_hash, robot_hash, model_version, path, vehicle, firmware, start_time, duration_s, status, reason, columns
  FROM flights QUALIFY row_number() OVER (PARTITION BY log_hash ORDER BY written_at DESC, robot_hash) = 1;

CREATE TABLE current AS
  WITH flown AS (
    SELECT vehicle, robot_hash, model_version, count(*) FILTER (status = 'ok') AS flights,
      count(*) FILTER (status <> 'ok') AS refused, max(start_time) FILTER (isfinite(start_time)) AS last_time,
      coalesce(arg_max(firmware, "order") FILTER (status = 'ok'), '') AS firmware, max(written_at) AS last_write
    FROM flights WHERE vehicle <> '' GROUP BY ALL)
  SELECT flown.* EXCLUDE (last_write), coalesce(verdict, '') AS verdict, coalesce(rejected, false) AS rejected, log_e,
    p_value, onset_flight, onset_low, onset_high, onset_time, kind, coalesce(text, '') AS text, crosses_limit_at,
    coalesce(causes, '[]') AS causes
  FROM flown LEFT JOIN verdicts USING (vehicle, robot_hash, model_version)
  QUALIFY row_number() OVER (PARTITION BY vehicle ORDER BY verdict IS NULL, flights = 0, last_write DESC, robot_hash) = 1;

CREATE TABLE sizes (vehicle VARCHAR, cause VARCHAR, size VARCHAR, scales DOUBLE);  -- Of the most probable cause of a change

CREATE VIEW totals AS
  SELECT (SELECT count(*) FROM newest WHERE status = 'ok') AS flights, (SELECT count(*) FROM newest WHERE status <> 'ok') AS refused,
    count(*) AS num_vehicles, count(*) FILTER (rejected) AS num_changed, count(DISTINCT firmware) AS num_cohorts FROM current;

CREATE VIEW changes AS
  SELECT vehicle, verdict, text FROM current WHERE rejected ORDER BY log_e DESC, vehicle LIMIT 10;

CREATE VIEW reasons AS
  SELECT reason, count(*) AS logs FROM newest WHERE status <> 'ok' GROUP BY reason ORDER BY logs DESC, reason LIMIT 5;

CREATE VIEW cohorts AS
  SELECT firmware, sum(flights)::BIGINT AS flights, count(*) AS vehicles, count(*) FILTER (rejected) AS changed
  FROM current GROUP BY firmware ORDER BY vehicles DESC, firmware LIMIT 12;

-- Of several starts of an effect, the one that the flight supports most.
CREATE TEMP VIEW histories AS
  SELECT * EXCLUDE (written_at) FROM evidence QUALIFY row_number() OVER (
    PARTITION BY vehicle, robot_hash, model_version, log_hash, effect, rotor ORDER BY score DESC, start) = 1;

-- A vehicle's value of each parameter, of several starts the most certain one.
CREATE TEMP VIEW states AS
  SELECT vehicle, robot_hash, model_version, effect, rotor, parameter, arg_min(value, std) AS value, min(std) AS std
  FROM vehicles GROUP BY ALL;

-- Median and middle 90 % of these values over the vehicles of one robot file.
CREATE TEMP VIEW bands AS
  SELECT robot_hash, model_version, effect, rotor, parameter, median(value) AS median, quantile_cont(value, 0.05) AS low,
    quantile_cont(value, 0.95) AS high, count(*) AS vehicles
  FROM states GROUP BY ALL;
