"""Public functions of vlab, with the defaults of the command line.

`vlab` exports the names. The commands call the same functions.
"""
