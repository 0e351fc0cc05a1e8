"""Hardware between structure and law: sensors, converters, filter, coils."""

from vlab.hardware.laboratory import Hardware, load_hardware

__all__ = ["Hardware", "load_hardware"]
