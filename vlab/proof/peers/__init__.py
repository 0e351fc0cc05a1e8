"""Other methods on the same cases, one module a method.

Each method is tuned as its users would tune it, with every choice in its docstring. No method reads the truth, and none
reads the answer of the diagnosis. A failure is a result with its reason.
"""
