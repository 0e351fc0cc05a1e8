"""The hardware between structure and control law: sensors, converters, delay and filter, force coils."""

from vlab.hardware.laboratory import Hardware, load_hardware

__all__ = ["Hardware", "load_hardware"]
