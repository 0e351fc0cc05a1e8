"""Experimental modal analysis: frequency responses, poles, shapes, comparison.

`modal_test` combines the steps. `recognise` identifies the excitation. `frf`, `steps` and `impact` estimate responses,
and `combine` merges several recordings. `distortion` separates noise from nonlinearity. `poles` identifies modes.
`appropriation` finds the forces that hold one mode, and `dwell` evaluates a held mode.
"""
