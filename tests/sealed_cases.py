"""A constant answer to concealed cases, and changes of their documents."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

ANSWER = {"verdict": "nothing-missing", "findings": [], "heldout": {"gap_closed": None}, "seconds": 1.0}


def edit(path: Path, change: Callable[[Any], object]) -> None:
    """Change a JSON document in place."""
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
