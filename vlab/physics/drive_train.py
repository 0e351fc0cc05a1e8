"""Drive train between a position servo's motor and its joint: play and elasticity, two inertias.

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


class DriveTrain(ServoEffect):
    """Train between motor and joint, with the moment of a spring and a damper beyond the play."""

    needs: ClassVar[tuple[str, ...]] = ("servo", "armature")
    is_fast = True

    def memory(self, shape: tuple[int, ...]) -> list[Any] | None:
        """See `PortEffect`: angle and velocity of the motor minus those of the joint."""
        return [np.zeros(shape) if shape else 0.0 for _ in range(2)]

    def play(self, p: Values) -> Any:
        """Return half the play.

        Parameters
        ----------
        p : Values
            Parameter values.
        """
        raise NotImplementedError

    def joint(self, z: Any, v: Any, step: Step) -> tuple[Any, Any, Any, Any, Any]:
        """Return the joint's motion in a step as a function of the train's moment T.

        The force F holds over the step and moves the joint, which the servo's modelled force feels. F cancels that force,
        so that F solves a linear equation.

        Parameters
        ----------
        z, v : float or array
            Displacement and velocity at the middle of the step.
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
        free = v if step.free_velocity is None else step.free_velocity
        first = 2.0 * v - free if step.first_velocity is None else step.first_velocity
        e = servo.error(step.command, z)
        if step.damped is None:  # the step is exact: the servo feels the mean motion
            force = servo.gain * e - 0.5 * servo.damping * (first + free)
            slope = 0.5 * servo.damping + servo.gain * h / 6.0
        else:
            force, slope = servo.gain * e - servo.damping * first, step.damped * servo.damping
        inside = force == servo.limited(force)
        force, slope = servo.limited(force), slope * inside
        if step.damped is not None:  # mobility and free velocity leave the servo's damping out
            kept = 1.0 / (1.0 + slope * mobility)
            mobility, free = mobility * kept, first + (free - first) * kept
            force = force - slope * (free - first)
        change = (free - first) / h
        denominator = 1.0 - mobility * (servo.inertia / h + slope)
        push = servo.inertia * change - force
        yielding = mobility / (h * denominator)
        return first, change + yielding * push, yielding, push, denominator

    def force(self, z: Any, v: Any, p: Values, step: Step, memory: Any) -> tuple[Any, Any]:
        """See `PortEffect`: an implicit midpoint step of motor and train.

        The servo's force on the motor is A - B m'' + E T, and between its limits.
        """
        servo, h, (apart, speed) = self.servo, step.h, memory
        first, acceleration, yielding, push, denominator = self.joint(z, v, step)
        joint, bend = (acceleration, yielding), 0.25 * h * h
        at = z + apart + 0.5 * h * speed - bend * acceleration  # of a motor that keeps its velocity
        A = servo.gain * servo.error(step.command, at) - servo.damping * (first + speed)
        B, E = 0.5 * h * servo.damping + bend * servo.gain, bend * servo.gain * yielding
        T, m = self._moment(memory, p, h, joint, (A, B, E))
        driving = servo.inertia * m + T
        if servo.limits[0] > -np.inf or servo.limits[1] < np.inf:
            most = servo.limited(driving)
            inside = driving == most
            A = np.where(inside, A, most) if not isinstance(A, float) else (A if inside else most)
            T, m = self._moment(memory, p, h, joint, (A, B * inside, E * inside))
        after = speed + h * (m - acceleration - yielding * T)
        return (T + push) / denominator, [apart + 0.5 * h * (speed + after), after]

    def _moment(
        self, memory: Any, p: Values, h: Any, joint: tuple[Any, Any], driving: tuple[Any, Any, Any]
    ) -> tuple[Any, Any]:
        """Return the train's mean moment and the motor's mean acceleration."""
        (apart, speed), (acceleration, yielding), (A, B, E) = memory, joint, driving
        heavy = self.servo.inertia + B + 1e-300
        alone = A / heavy - acceleration  # relative acceleration without a moment
        ease = (1.0 - E) / heavy + yielding
        middle, rate = apart + 0.5 * h * (speed + 0.5 * h * alone), speed + 0.5 * h * alone
        stiffness = p["stiffness"]
        damper = 2.0 * p["damping_ratio"] * np.sqrt(stiffness * self.servo.inertia)
        beyond = middle - limited(middle, self.play(p))
        pressing = (stiffness * beyond + damper * rate) * (beyond != 0.0)
        T = pressing / (1.0 + ease * (0.25 * h * h * stiffness + 0.5 * h * damper))
        return T, (A - (1.0 - E) * T) / heavy


STIFFNESSES = (4.0, 20.0, 100.0)
"""STIFFNESSES [1]: trial stiffnesses of a train with play, over the servo's gain. A play shows whatever the stiffness, so
the grid is coarse."""
SOFT = (1.0, 3.0, 10.0, 30.0)
"""SOFT [1]: trial stiffnesses of a train without play, over the servo's gain. A stiffer train is rigid to a servo."""
_DAMPING = Parameter(
    name="damping_ratio", unit="1", low=1e-3, high=2.0, role="shape", grid=(0.1,),
    words="of the motor's inertia on the train, the joint held",
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
    )  # fmt: skip

    def play(self, p: Values) -> Any:
        """See `DriveTrain`."""
        return 0.0
