"""Predictors: modal, along a trajectory, in frequency, and the Kalman filter."""
