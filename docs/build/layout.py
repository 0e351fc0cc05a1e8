"""The package as a wheel lays it out, for the Python reference: `controllers` lies in it, and stands beside it in a checkout."""

import tempfile
from pathlib import Path
from typing import Any

from mkdocs.plugins import event_priority

ROOT = Path(__file__).parents[2]
_folder = tempfile.TemporaryDirectory(prefix="vlab-docs-")
"""Kept as long as the build runs."""


@event_priority(100)  # before mkdocstrings reads its settings
def on_config(config: Any) -> Any:
    """Let mkdocstrings find the package in a folder of links."""
    package = Path(_folder.name) / "vlab"
    if not package.exists():
        package.mkdir()
        for part in (ROOT / "vlab").iterdir():
            if part.name not in ("controllers", "__pycache__"):
                (package / part.name).symlink_to(part)
        laws = package / "controllers"
        laws.mkdir()
        for part in (*(ROOT / "vlab" / "controllers").glob("*.py"), *(ROOT / "controllers").glob("*.py")):
            (laws / part.name).symlink_to(part)
    config.plugins["mkdocstrings"].config.handlers["python"]["paths"] = [_folder.name]
    return config
