"""Experimental modal analysis: recordings to frequency responses, those to poles and shapes, and how shapes compare."""
