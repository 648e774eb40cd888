// What PX4's order of desaturation needs of the class it belongs to, without PX4's matrices and parameters: motors, their limits,
// commands and the mixing matrix. Compiled with that one source of a PX4 checkout (see px4_mixer_vectors.py).
#pragma once
#include <cmath>

static constexpr int MOTORS = 6;

struct ActuatorVector {
	float numbers[MOTORS] {};

	float &operator()(int i) { return numbers[i]; }
	float operator()(int i) const { return numbers[i]; }

	ActuatorVector operator-(const ActuatorVector &other) const
	{
		ActuatorVector out;

		for (int i = 0; i < MOTORS; i++) { out(i) = numbers[i] - other(i); }

		return out;
	}

	ActuatorVector operator*(float scale) const
	{
		ActuatorVector out;

		for (int i = 0; i < MOTORS; i++) { out(i) = numbers[i] * scale; }

		return out;
	}

	void operator+=(const ActuatorVector &other)
	{
		for (int i = 0; i < MOTORS; i++) { numbers[i] += other(i); }
	}
};

struct ControlVector {
	float numbers[6] {};

	float &operator()(int i) { return numbers[i]; }
};

struct MixingMatrix {
	float numbers[MOTORS][6] {};

	float &operator()(int i, int axis) { return numbers[i][axis]; }
};

struct Airmode {
	int value = 0;

	int get() const { return value; }
};

class ControlAllocationSequentialDesaturation
{
public:
	enum ControlAxis { ROLL = 0, PITCH, YAW, THRUST_X, THRUST_Y, THRUST_Z };

	void allocate();
	void updateParameters();
	void updateParams() {}
	void updatePseudoInverse() {}
	void desaturateActuators(ActuatorVector &signal, const ActuatorVector &column, bool increase_only = false);
	float computeDesaturationGain(const ActuatorVector &column, const ActuatorVector &signal);
	void mixAirmodeRP();
	void mixAirmodeRPY();
	void mixAirmodeDisabled();
	void mixYaw();

	int _num_actuators = MOTORS;
	ActuatorVector _actuator_sp, _prev_actuator_sp, _actuator_trim, _actuator_min, _actuator_max;
	ControlVector _control_sp, _control_trim;
	MixingMatrix _mix;
	Airmode _param_mc_airmode;
};
