"""Golden answers: what `diagnose` says of cases, kept to the last bit, so that two versions of the code can be compared.

Store the answers of one version, then compare those of another on the same machine (other processors round otherwise)::

    python tests/golden.py assets/cases/emps assets/cases/silverbox --store golden.json
    python tests/golden.py assets/cases/emps assets/cases/silverbox --against golden.json

Exit status 1 where an answer differs; the differing keys are printed.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

from vlab.cases import load_case
from vlab.diagnose.pipeline import diagnose
from vlab.errors import VlabError
from vlab.files.output_folder import finite


def answer_of(folder: Path) -> dict[str, Any]:
    """Return what is said of a case, floats as hexadecimal numbers, without the time that it took."""
    try:
        said = diagnose(load_case(folder)).diagnosis.to_json()
    except VlabError as error:
        return {"error": str(error)}
    said.pop("seconds")
    return _exact(finite(said))


def differences(one: Any, other: Any, at: str = "") -> list[str]:
    """Return the keys at which two answers differ."""
    if isinstance(one, dict) and isinstance(other, dict):
        return [
            line
            for key in sorted({*one, *other})
            for line in differences(one.get(key), other.get(key), f"{at}.{key}" if at else key)
        ]
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        return [
            line for i, (a, b) in enumerate(zip(one, other, strict=True)) for line in differences(a, b, f"{at}[{i}]")
        ]
    return [] if one == other else [f"{at}: {_shown(one)} -> {_shown(other)}"]


def _exact(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _exact(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_exact(part) for part in value]
    return value.hex() if isinstance(value, float) else value


def _shown(value: Any) -> str:
    if isinstance(value, str) and value.lstrip("-").startswith("0x"):
        return f"{float.fromhex(value):.17g}"
    return json.dumps(value)[:120]


def main() -> int:
    """Run the cases of the command line; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="+", type=Path)
    parser.add_argument("--store", type=Path, help="write the answers to this file; those already in it are kept")
    parser.add_argument("--against", type=Path, help="compare with the answers in this file")
    arguments = parser.parse_args()
    stored = json.loads(arguments.store.read_text()) if arguments.store and arguments.store.exists() else {}
    known = json.loads(arguments.against.read_text()) if arguments.against else {}
    status = 0
    for case in arguments.cases:
        name = "/".join(case.resolve().parts[-2:])
        if arguments.store and name in stored:
            continue
        began = time.perf_counter()
        answer = answer_of(case)
        print(f"{name}: {answer.get('verdict', answer.get('error'))}, {time.perf_counter() - began:.0f} s", flush=True)
        if arguments.store:
            stored[name] = answer
            arguments.store.write_text(json.dumps(stored, indent=1, sort_keys=True) + "\n")
        if arguments.against:
            lines = differences(known.get(name), answer)
            status = status or bool(lines)
            print("".join(f"  {line}\n" for line in lines), end="", flush=True)
    return int(status)


if __name__ == "__main__":
    sys.exit(main())
