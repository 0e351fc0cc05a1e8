"""vlab: a virtual laboratory for flexible structures under active vibration control, on MuJoCo."""

__version__ = "0.1.0"
