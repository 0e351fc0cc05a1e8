"""Drive train between a position servo's motor and its joint.

The model lumps the motor's inertia J (the armature) with the joint's inertia I at the joint's angle q. With a train in
between, the motor has an angle m of its own, in units of the servo's length. The servo's force tau acts on the motor, with
its loop closed on the motor's angle. The train passes the moment T(m - q) on [1]_:

    J m'' = tau(u, m, m') - T,    I q'' = T + all other moments on the joint.

The model has (I + J) q'' = tau(u, q, q') + all other moments. So the train adds the force F = T - tau(u, q, q') + J q''
along the joint.

References
----------
.. [1] M. Nordin and P.-O. Gutman, Controlling mechanical systems with backlash - a survey, Automatica 38 (2002)
       1633-1649.
"""

from typing import Any, ClassVar

import numpy as np

from vlab.physics.effect import Parameter, Step, Values, limited
from vlab.physics.servo import ServoEffect


def chosen(flag: Any, x: Any, y: Any) -> Any:
    """Return x where a flag is set, and y elsewhere.

    A MuJoCo step has plain numbers, for which a branch is ten times as fast as numpy.
    """
    if isinstance(flag, (bool, np.bool_)):
        return x if flag else y
    return np.where(flag, x, y)


class DriveTrain(ServoEffect):
    """Train of motor and joint: spring and damper beyond the play.

    A model lumps the damping of motor and gear with that of the joint's bearing. The share on the motor's side is a
    parameter.
    """

    needs: ClassVar[tuple[str, ...]] = ("servo", "armature")
    numbers: ClassVar[tuple[str, ...]] = ("gain", "damping", "inertia", "drag")
    is_fast = True

    def memory(self, shape: tuple[int, ...]) -> list[Any] | None:
        """See `PortEffect`: angle and velocity of the motor from the joint."""
        return [np.zeros(shape) if shape else 0.0 for _ in range(2)]

    def play(self, p: Values) -> Any:
        """Return half the play.

        Parameters
        ----------
        p : Values
            Parameter values.
        """
        raise NotImplementedError

    def own(self, p: Values, at: str) -> tuple[Any, Any, Any, Any]:
        """Return the servo's gain and damping, motor inertia, joint damping.

        Parameters
        ----------
        p : Values
            Parameter values, with the servo's `numbers` where a calibration changes them.
        at : str
            ``"servo"`` for the servo itself, ``"model"`` for the simulated model to which the force is added.

        Returns
        -------
        tuple of (object, object, object, object)
            Gain, damping, inertia and damping of the joint, along the transmission.
        """
        servo = self.servo
        return (
            p.get(f"{at}.gain", servo.gain),
            p.get(f"{at}.damping", servo.damping),
            p.get(f"{at}.inertia", servo.inertia),
            p.get(f"{at}.drag", servo.drag),
        )

    def joint(self, z: Any, v: Any, p: Values, step: Step) -> tuple[Any, Any, Any, Any, Any]:
        """Return the joint's motion as a function of the train's moment.

        The force F holds over the step and moves the joint, which the servo's modelled force feels. F cancels that force,
        so that F solves a linear equation.

        Parameters
        ----------
        z, v : float or array
            Displacement and velocity at the middle of the step.
        p : Values
            Parameter values.
        step : Step
            Data of the step. A motion without `free_velocity` has a constant velocity.

        Returns
        -------
        first : float or array
            Velocity at the beginning of the step.
        acceleration, yielding : float or array
            Mean acceleration without T, and per unit of T: one over the joint's own inertia, 0 for a given motion.
        push, denominator : float or array
            Numbers of the force F = (T + push)/denominator.
        """
        servo, h, mobility = self.servo, step.h, step.mobility
        gain, damping, inertia, drag = self.own(p, "model")
        drag = drag - (1.0 - p["motor_share"]) * self.own(p, "servo")[3]
        free = v if step.free_velocity is None else step.free_velocity
        first = 2.0 * v - free if step.first_velocity is None else step.first_velocity
        e = servo.error(step.command, z)
        if step.damped is None:  # the step is exact: the servo feels the mean motion
            force = gain * e - 0.5 * damping * (first + free)
            slope, late = 0.5 * damping + gain * h / 6.0, 0.5
        else:  # dampers of joints are implicit in every integrator of one stage
            force, slope, late = gain * e - damping * first, step.damped * damping, 0.5 if step.damped == 0.5 else 1.0
        inside = force == servo.limited(force)
        force, slope = servo.limited(force), slope * inside
        if step.damped is not None:  # mobility and free velocity leave the servo's damping out
            kept = 1.0 / (1.0 + slope * mobility)
            mobility, free = mobility * kept, first + (free - first) * kept
            force = force - slope * (free - first)
        change = (free - first) / h
        denominator = 1.0 - mobility * (inertia / h + slope + late * drag)
        push = inertia * change - force + drag * (first + late * h * change)
        yielding = mobility / (h * denominator)
        return first, change + yielding * push, yielding, push, denominator

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`: an implicit midpoint step of motor and train.

        The servo's force on the motor is A - B m'' + E T, and between its limits.
        """
        servo, h, (apart, speed) = self.servo, step.h, memory
        gain, damping, inertia, drag = self.own(p, "servo")
        drag = p["motor_share"] * drag
        first, acceleration, yielding, push, denominator = self.joint(z, v, p, step)
        bend = 0.25 * h * h
        at = z + apart + 0.5 * h * speed - bend * acceleration  # of a motor that keeps its velocity
        A = gain * servo.error(step.command, at) - damping * (first + speed)
        B, E = 0.5 * h * damping + bend * gain, bend * gain * yielding
        # the damping on the motor's side is behind the servo's limits
        braking, heavy = drag * (first + speed), inertia + 0.5 * h * drag + 1e-300
        relative = apart, speed, acceleration, yielding
        T, m = self._moment(p, h, relative, (A - braking, heavy + B, E))
        driving = heavy * m + braking + T
        if servo.limits[0] > -np.inf or servo.limits[1] < np.inf:
            most = servo.limited(driving)
            inside = driving == most
            A = chosen(inside, A, most)
            T, m = self._moment(p, h, relative, (A - braking, heavy + B * inside, E * inside))
        after = speed + h * (m - acceleration - yielding * T)
        return (T + push) / denominator, [apart + 0.5 * h * (speed + after), after]

    def _moment(
        self, p: Values, h: Any, relative: tuple[Any, Any, Any, Any], motor: tuple[Any, Any, Any]
    ) -> tuple[Any, Any]:
        """Return the train's mean moment and the motor's mean acceleration.

        The spring's moment is the mean over a straight path from the step's beginning to its end. So the moment does not
        jump where a step ends at a stop. Newton steps solve for the end of the path.
        """
        (apart, speed, acceleration, yielding), (A, heavy, E) = relative, motor
        alone = A / heavy - acceleration  # relative acceleration without a moment
        ease = (1.0 - E) / heavy + yielding
        stiffness, play = p["stiffness"], self.play(p)
        damper = 2.0 * p["damping_ratio"] * np.sqrt(stiffness * self.own(p, "servo")[2])
        before = apart - limited(apart, play)
        T: Any = 0.0
        for _ in range(NEWTON):
            rate = speed + 0.5 * h * (alone - ease * T)
            end = apart + h * rate
            after = end - limited(end, play)
            is_short = abs(end - apart) <= SHORT * (abs(end) + abs(apart)) + 1e-300
            path = chosen(is_short, 1.0, end - apart)
            share = chosen(is_short, 1.0 * (before != 0.0), (after - before) / path)  # of the path, beyond the play
            mean = 0.5 * (before + after) * share
            slope = chosen(is_short, 0.5 * share, (after - mean) / path)  # of the mean, by the end
            missed = stiffness * mean + damper * share * rate - T
            T = T + missed / (1.0 + 0.5 * h * ease * (h * stiffness * slope + damper * share))
        return T, (A - (1.0 - E) * T) / heavy


SHORT = 1e-9
"""SHORT [1]: path of a step over the deflection below which the path has no direction, above the rounding of numbers."""
NEWTON = 3
"""NEWTON [1]: Newton steps for a train's moment within a step, at least 1; default from the error of runs with play, which
more steps leave. Raising it costs time."""
STIFFNESSES = (4.0, 20.0, 100.0)
"""STIFFNESSES [1]: trial stiffnesses of a train with play, over the servo's gain. A play shows whatever the stiffness, so
the grid is coarse."""
SOFT = (1.0, 3.0, 10.0, 30.0)
"""SOFT [1]: trial stiffnesses of a train without play, over the servo's gain. A stiffer train is rigid to a servo."""
_DAMPING = Parameter(
    name="damping_ratio", unit="1", low=1e-3, high=2.0, role="shape", grid=(0.1,),
    words="of the motor's inertia on the train, the joint held",
)  # fmt: skip
_SHARE = Parameter(
    name="motor_share", unit="1", low=0.01, high=1.0, role="shape", grid=(0.1, 1.0),
    words="of the joint's modelled damping: motor and gear, not the joint's bearing",
)  # fmt: skip


class ServoBacklash(DriveTrain):
    """Play between a servo's motor and its joint.

    Motor and joint move on their own within the play. A loop closed on the motor holds the motor, and the joint stands
    anywhere within the play.
    """

    name = "servo-backlash"
    family = "clearance"
    law = "J m'' = force(u, m, m') - T, T = k s + c s' beyond the gap: s = m - q -+ gap, m the motor's angle"
    words = "play between a servo's motor and its joint: a worn gear or coupling, two inertias that hit each other"
    parameters: ClassVar = (
        Parameter(
            name="gap", unit="m", low=0.001, high=0.9, role="shape", reference="displacement",
            grid=(0.003, 0.012, 0.05, 0.15, 0.4), words="half of the play",
        ),
        Parameter(
            name="stiffness", unit="N/m", low=1.0, high=1e4, role="shape", reference="servo-gain", grid=STIFFNESSES,
            words="of the train beyond the play",
        ),
        _DAMPING,
        _SHARE,
    )  # fmt: skip

    def play(self, p: Values) -> Any:
        """See `DriveTrain`."""
        return p["gap"]


class ServoCompliance(DriveTrain):
    """An elastic train between a servo's motor and its joint.

    Under a constant load F the joint droops by F (1/kp + 1/k). Motor and joint swing against each other at
    sqrt(k (1/J + 1/I)).
    """

    name = "servo-compliance"
    family = "stiffness"
    law = "J m'' = force(u, m, m') - T, T = k s + c s', s = m - q, m the motor's angle"
    words = "an elastic gear, belt or shaft between a servo's motor and its joint"
    parameters: ClassVar = (
        Parameter(
            name="stiffness", unit="N/m", low=0.1, high=1e4, role="shape", reference="servo-gain", grid=SOFT,
            words="of the train",
        ),
        _DAMPING,
        _SHARE,
    )  # fmt: skip

    def play(self, p: Values) -> Any:
        """See `DriveTrain`."""
        return 0.0
