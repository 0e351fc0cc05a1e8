"""Experimental modal analysis: recordings to frequency responses, those to poles and shapes, and how shapes compare.

`modal_test` puts it together: `recognise` says what excited a recording, `frf`, `steps` and `impact` estimate responses,
`combine` makes several recordings one, `distortion` tells noise from nonlinearity, `poles` finds modes, `appropriation` the
forces that hold one of them, and `dwell` looks at a mode so held.
"""
