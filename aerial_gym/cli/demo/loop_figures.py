"""Before and after of the closed loop, drawn from the contents of ``verdict.json``."""

from typing import Any

from matplotlib.figure import Figure

KINDS = ("specific_force", "angular_acceleration", "rotor_speed")
LABELS = {
    "specific_force": "specific force",
    "angular_acceleration": "angular acceleration",
    "rotor_speed": "rotor speed",
}


def residual_rows(verdict: dict[str, Any]) -> list[dict[str, Any]]:
    """Return one row per channel: name, unit, rms before and after with their intervals, noise floor."""
    rows = []
    for kind in KINDS:
        before, after = verdict["before"].get(kind, {}), verdict["after"].get(kind, {})
        for axis in before:
            if axis != "unit":
                rows.append(
                    {
                        "kind": kind,
                        "name": f"{LABELS[kind]} {axis}",
                        "unit": before["unit"],
                        "before": before[axis],
                        "after": after[axis],
                    }
                )
    return rows


def residual_figure(verdict: dict[str, Any]) -> Figure:
    """Return bars of the residual (rms) of every channel before and after, with intervals and noise floor."""
    rows = residual_rows(verdict)
    kinds = [kind for kind in KINDS if any(row["kind"] == kind for row in rows)]
    figure = Figure(figsize=(3.6 * len(kinds), 3.4), layout="constrained")
    for axis, kind in zip(figure.subplots(1, len(kinds), squeeze=False)[0], kinds, strict=True):
        kind_rows = [row for row in rows if row["kind"] == kind]
        for shift, when, color in ((-0.2, "before", "#c44e52"), (0.2, "after", "#4c72b0")):
            places = [i + shift for i in range(len(kind_rows))]
            values = [row[when] for row in kind_rows]
            axis.bar(places, [v["rms"] for v in values], 0.38, color=color, label=when)
            low, high = zip(*(v["interval"] for v in values), strict=True)
            axis.vlines(places, low, high, color="k", lw=1.2)
        for i, row in enumerate(kind_rows):
            if "noise_floor" in row["after"]:
                label = "noise floor" if i == 0 else None
                axis.hlines(row["after"]["noise_floor"], i - 0.42, i + 0.42, color="k", ls=":", label=label)
        axis.set_xticks(range(len(kind_rows)), [row["name"].split()[-1] for row in kind_rows])
        axis.set_title(f"{LABELS[kind]} [{kind_rows[0]['unit']}]", fontsize=10)
        axis.set_ylabel("residual, rms")
    figure.axes[0].legend(fontsize=8)
    return figure


def rollout_figure(verdict: dict[str, Any]) -> Figure:
    """Return the open-loop error of position and velocity over the horizon, before and after."""
    variants = [name for name in ("rollout", "rollout_given_attitude") if name in verdict["before"]]
    figure = Figure(figsize=(9.0, 3.2 * max(1, len(variants))), layout="constrained")
    if not variants:
        figure.text(0.1, 0.5, "These logs have no velocity: no rollouts.")
        return figure
    for axes, variant in zip(figure.subplots(len(variants), 2, squeeze=False), variants, strict=True):
        for axis, quantity in zip(axes, ("position", "velocity"), strict=True):
            for when, color in (("before", "#c44e52"), ("after", "#4c72b0")):
                entries = {h: v for h, v in verdict[when][variant].items() if isinstance(v, dict) and quantity in v}
                horizon = [float(h) for h in entries]
                values = [v[quantity] for v in entries.values()]
                axis.plot(horizon, [v["rms"] for v in values], "o-", color=color, label=when)
                low, high = zip(*(v["interval"] for v in values), strict=True)
                axis.fill_between(horizon, low, high, color=color, alpha=0.2)
            axis.set_xlabel("horizon [s]")
            axis.set_ylabel(f"{quantity} error [{next(iter(entries.values()))[quantity]['unit']}], rms")
            note = "attitude from the log" if variant.endswith("attitude") else "open loop"
            axis.set_title(note, fontsize=9)
            axis.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=8)
    return figure
