// The classes of PX4's control libraries behind plain C functions, for rows of states. Only what PX4's own headers cannot give on
// a host stands here; the controllers themselves are compiled from a checkout of PX4 (see px4_vectors.py).
#include <rate_control/rate_control.hpp>
#include <AttitudeControl.hpp>
#include <PositionControl.hpp>

using matrix::Quatf;
using matrix::Vector;
using matrix::Vector3f;

extern "C" {

// gains: P, I, D, feed-forward, integral limit (15); steps: rate, setpoint, acceleration, signs of saturation, dt (13)
void rate_control(int runs, int steps, const float *gains, const float *in, float *torque)
{
	for (int i = 0; i < runs; i++, gains += 15) {
		RateControl control;
		control.setPidGains(Vector3f(gains), Vector3f(gains + 3), Vector3f(gains + 6));
		control.setFeedForwardGain(Vector3f(gains + 9));
		control.setIntegratorLimit(Vector3f(gains + 12));

		for (int k = 0; k < steps; k++, in += 13, torque += 3) {
			Vector<bool, 3> positive, negative;

			for (int a = 0; a < 3; a++) {
				positive(a) = in[9 + a] > 0.5f;
				negative(a) = in[9 + a] < -0.5f;
			}

			control.setSaturationStatus(positive, negative);
			control.update(Vector3f(in), Vector3f(in + 3), Vector3f(in + 6), in[12], false).copyTo(torque);
		}
	}
}

// in: attitude (4, wxyz), setpoint (4), yaw rate, gains (3), yaw weight, rate limit (3)
void attitude_control(int rows, const float *in, float *rate)
{
	for (int i = 0; i < rows; i++, in += 16, rate += 3) {
		AttitudeControl control;
		control.setProportionalGain(Vector3f(in + 9), in[12]);
		control.setRateLimit(Vector3f(in + 13));
		control.setAttitudeSetpoint(Quatf(in + 4), in[8]);
		control.update(Quatf(in)).copyTo(rate);
	}
}

// gains: position (3), velocity P, I, D (9), speed, up, down, least and largest thrust, margin, tilt, hover thrust (20)
// steps: position, velocity, acceleration, wanted position or velocity (12), yaw, dt, whether a velocity is wanted (15)
// out: acceleration, thrust (6), attitude (4, wxyz)
void position_control(int runs, int steps, const float *gains, const float *in, float *out)
{
	for (int i = 0; i < runs; i++, gains += 20) {
		PositionControl control;
		control.setPositionGains(Vector3f(gains));
		control.setVelocityGains(Vector3f(gains + 3), Vector3f(gains + 6), Vector3f(gains + 9));
		control.setVelocityLimits(gains[12], gains[13], gains[14]);
		control.setThrustLimits(gains[15], gains[16]);
		control.setHorizontalThrustMargin(gains[17]);
		control.setTiltLimit(gains[18]);
		control.setHoverThrust(gains[19]);

		for (int k = 0; k < steps; k++, in += 15, out += 10) {
			control.setState({Vector3f(in), Vector3f(in + 3), Vector3f(in + 6), 0.f});
			vehicle_local_position_setpoint_s wanted{};
			const bool velocity = in[14] > 0.5f;
			float *given[2][3] = {{&wanted.x, &wanted.y, &wanted.z}, {&wanted.vx, &wanted.vy, &wanted.vz}};

			for (int a = 0; a < 3; a++) {
				*given[velocity][a] = in[9 + a];
				*given[!velocity][a] = NAN;
				wanted.acceleration[a] = NAN;
			}

			wanted.yaw = in[12];
			wanted.yawspeed = NAN;
			control.setInputSetpoint(wanted);
			control.update(in[13]);
			vehicle_local_position_setpoint_s used{};
			vehicle_attitude_setpoint_s attitude{};
			control.getLocalPositionSetpoint(used);
			control.getAttitudeSetpoint(attitude);

			for (int a = 0; a < 3; a++) {
				out[a] = used.acceleration[a];
				out[3 + a] = used.thrust[a];
			}

			for (int a = 0; a < 4; a++) {
				out[6 + a] = attitude.q_d[a];
			}
		}
	}
}
}
