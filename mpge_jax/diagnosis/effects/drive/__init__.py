"""What stands between motor and link: the rotor's inertia, a spring, or a gap; and how a servo brakes."""

from mpge_jax.diagnosis.effects.drive import armature, backlash, damped_motor, flexible, servo_braking

__all__ = ["armature", "backlash", "damped_motor", "flexible", "servo_braking"]
