"""Text tables of control tests: actuator effort and damping after a release."""

from collections.abc import Mapping, Sequence
from typing import Any

from vlab.cli.table import text_table
from vlab.errors import BadRecording
from vlab.lab.excitation import Excitation, Release
from vlab.lab.ring_down import ring_down
from vlab.lab.run_folder import DoneRun

LEAST_PERIODS = 2
"""LEAST_PERIODS [-]: periods of a record for averaging. Of four periods, the first half settles."""


def effort_table(runs: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Return actuator effort as a text table.

    Parameters
    ----------
    runs : mapping
        Actuator data by name of the run.

    Returns
    -------
    str
        Text table.
    """
    keys = ("command_rms", "command_peak", "force_rms", "force_peak")
    rows = [
        [run, part["at"], *(f"{part[key]:.4f}" for key in keys), part["unit"], f"{100 * part['saturated_share']:.2g} %"]
        for run, parts in runs.items()
        for part in parts
    ]
    headers = ["run", "actuator", "command rms", "command peak", "force rms", "force peak", "unit", "at its limit"]
    return text_table(headers, rows)


def ring_down_table(runs: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Return identified and predicted modes after a release."""
    keys = ("mode", "predicted_hz", "hz", "predicted_zeta", "zeta", "zeta_envelope")
    rows = [[run, *(mode[key] for key in keys)] for run, modes in runs.items() for mode in modes]
    headers = ["run", "mode", "pole Hz", "released Hz", "pole zeta", "released zeta", "envelope zeta"]
    return text_table(headers, rows)


def loop_facts(done: DoneRun) -> dict[str, Any]:
    """Return actuator effort and decay as plain data.

    Parameters
    ----------
    done : DoneRun
        Completed run.

    Returns
    -------
    dict
        Plain data for JSON.
    """
    document: dict[str, Any] = {"effort": done.effort}
    if isinstance(done.prepared.experiment.excitation, Release):
        try:
            modes, why = ring_down(done.prepared, done.result.recording), ""
        except BadRecording as error:
            modes, why = (), str(error)
        document["ring_down"] = {"modes": [mode.as_dict() for mode in modes], "why_not": why}
    return document


def loop_text(document: Mapping[str, Any]) -> str:
    """Return the facts of a loop as text.

    Actuators without a law and without a limit are omitted.

    Parameters
    ----------
    document : mapping
        Facts of `loop_facts`.

    Returns
    -------
    str
        Lines of text.
    """
    lines = []
    effort = [part for part in document["effort"].values() if part["command_peak"] or part["saturated_share"]]
    if effort:
        lines += [effort_table({"": effort}), ""]
    found = document.get("ring_down", {"modes": []})
    if found["modes"]:
        lines += [ring_down_table({"": found["modes"]}), ""]
    elif found.get("why_not"):
        lines += [f"no damping from the release: {found['why_not']}", ""]
    return "".join(f"{line}\n" for line in lines)


def periods_of(excitation: Excitation | None, seconds: float) -> float | None:
    """Return the number of excitation periods, or None."""
    period = None if excitation is None else excitation.period_s
    return None if period is None else seconds / period


def period_text(excitation: Excitation | None, seconds: float) -> str:
    """Return a warning for a too short record.

    Parameters
    ----------
    excitation : Excitation or None
        Excitation.
    seconds : float
        Duration of the record [s].

    Returns
    -------
    str
        Warning; empty for a sufficient record.
    """
    periods = periods_of(excitation, seconds)
    if periods is None or periods >= LEAST_PERIODS - 1e-9:
        return ""
    period = seconds / periods
    return (
        f"the record holds {periods:.3g} period{'s' * (f'{periods:.3g}' != '1')} of its excitation ({period:g} s): a response without leakage needs "
        f"{LEAST_PERIODS} at least, and 4 to settle in; give --seconds {2 * LEAST_PERIODS * period:g}, or a shorter --period\n\n"
    )
