"""Diagnosis of a case as one object: findings, figures, report, extended model."""

import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from vlab.api.progress import Progress, reported
from vlab.cases.case import Case, load_case
from vlab.controllers.user_law import code_of
from vlab.diagnose.diagnosis import Finding, RejectedCase, Verdict
from vlab.diagnose.export import Done, native_model
from vlab.diagnose.parameters.locations import is_named
from vlab.diagnose.pipeline import diagnose as run_pipeline
from vlab.errors import BadCase, BadExperiment, OutputRefused, unknown_name
from vlab.files.arguments import checked
from vlab.files.output_folder import finite, output_folder, write_manifest
from vlab.files.text import as_sentence, in_line
from vlab.parallel import limited_to
from vlab.physics.catalogue import CANDIDATES, EFFECTS, effect_named
from vlab.physics.effect import Effect
from vlab.plants.base import Plant
from vlab.plants.mjcf import MjcfPlant
from vlab.units import quantity

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis:
    """Answer of a diagnosis with its models.

    Parameters
    ----------
    case : Case
        Diagnosed case.
    done : Diagnosed, FrequencyDiagnosed or RejectedCase
        Result of the pipeline: answer, search and models.
    """

    case: Case
    done: Done | RejectedCase

    @property
    def verdict(self) -> Verdict:
        """Verdict in one word, such as ``"missing-physics"``."""
        return self.done.diagnosis.verdict

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Missing physics in order of what each explains."""
        return self.done.diagnosis.findings

    def to_dict(self) -> dict[str, Any]:
        """Return the plain data of ``diagnosis.json`` without remarks on files."""
        document: dict[str, Any] = finite(self.done.diagnosis.to_json())
        return document

    def model(self) -> Any:
        """Return the extended model, or the calibrated model without findings.

        Returns
        -------
        MjModel
            Compiled model with the findings as MuJoCo elements.

        Raises
        ------
        BadExperiment
            A finding has no MuJoCo element, the model is a structure, or the case was rejected.
        """
        if isinstance(self.done, RejectedCase):
            raise BadExperiment(f"the case was rejected, so there is no extended model: {self._reason()}")
        return native_model(self.done)

    def plot(self, what: Literal["overlay", "force"] = "overlay") -> "Figure":
        """Draw the main figure.

        Parameters
        ----------
        what : str
            ``"overlay"``: the worst channel with calibrated and extended model. ``"force"``: the missing force over its
            variables, with the identified law.

        Returns
        -------
        Figure
            Matplotlib figure.

        Raises
        ------
        BadExperiment
            The diagnosis has no such figure.
        """
        from vlab.views.reports.diagnosis_figures import main_figure, missing_force_figure

        draw = {"overlay": main_figure, "force": missing_force_figure}
        if what not in draw:
            raise unknown_name("figure", what, draw)
        if isinstance(self.done, RejectedCase):
            raise BadExperiment(f"the case was rejected, so there is no figure: {self._reason()}")
        figure = draw[what](self.done)
        if figure is None:
            why = "no model can follow the recordings" if what == "overlay" else "no force was found"
            raise BadExperiment(f"this diagnosis has no figure {what!r}: {why}")
        return figure

    def report(self, path: Path | str) -> Path:
        """Write the report as one HTML page, which works offline.

        Parameters
        ----------
        path : Path or str
            File that ends in ``.html``; an existing file is replaced.

        Returns
        -------
        Path
            Written file.

        Raises
        ------
        OutputRefused
            The name ends otherwise, or the file cannot be written.
        """
        from vlab.views.reports.diagnosis import write_page

        path = Path(path)
        if path.suffix.lower() not in (".html", ".htm"):
            raise OutputRefused(f"{path}: the report is an HTML page; name a file that ends in .html")
        write_page(self.done, path)
        return path

    def save(self, folder: Path | str, *, overwrite: bool = False) -> Path:
        """Write the output folder of ``vlab diagnose``.

        The folder holds JSON, report, Rerun file and the extended model with its case.

        Parameters
        ----------
        folder : Path or str
            Output folder.
        overwrite : bool
            Whether a folder that vlab wrote is replaced.

        Returns
        -------
        Path
            Written folder.

        Raises
        ------
        OutputRefused
            The folder exists, or cannot be written.
        """
        with output_folder(folder, overwrite=overwrite) as fresh:
            self.write_into(fresh)
        return Path(folder)

    def write_into(self, folder: Path) -> None:
        """Write the files of `save` into an open output folder.

        Parameters
        ----------
        folder : Path
            Folder of `vlab.files.output_folder.output_folder`.
        """
        from vlab.views.reports.diagnosis import write_diagnosis

        write_diagnosis(self.done, folder)
        write_manifest(folder, verb="diagnose", case=str(self.case.path))

    def _reason(self) -> str:
        return "; ".join(self.done.diagnosis.quality) or "its files contradict the description"

    def __repr__(self) -> str:
        """Return the verdict, and one line a finding."""
        diagnosis = self.done.diagnosis
        title = f" of {in_line(diagnosis.title)!r}" if diagnosis.title else ""
        gap = diagnosis.heldout["gap_closed"]
        closed = "" if gap is None or not diagnosis.findings else f", {100 * gap:.0f} % of the gap closed"
        lines = [f"<Diagnosis{title}: {self.verdict}{closed}>"]
        lines += [f"  {finding}" for finding in self.findings]
        if isinstance(self.done, RejectedCase):
            lines += [f"  {in_line(line)}" for line in diagnosis.quality]
        elif self.verdict == "bad-recording":
            lines += [f"  {in_line(line)}" for line in diagnosis.quality[:1]]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """Return verdict, findings and errors as a small table for notebooks."""
        from vlab.views.reports.diagnosis_summary import verdict_sentence

        diagnosis = self.done.diagnosis
        sentence = self._reason() if isinstance(self.done, RejectedCase) else verdict_sentence(self.done)
        if self.verdict == "bad-recording" and not isinstance(self.done, RejectedCase):
            sentence = " ".join([sentence, *(as_sentence(in_line(line)) for line in diagnosis.quality[:1])])
        parts = [f"<p><b>{html.escape(self.verdict)}</b>: {html.escape(sentence)}</p>"]
        rows = [
            [f.name, place, f"{name} = {quantity(p['value'], p['unit'])}", f"{p['ci90'][0]:.4g} to {p['ci90'][1]:.4g}"]
            for f in self.findings
            for place, parameters in f.places
            for name, p in parameters.items()
        ]
        parts += [_html_table(("effect", "place", "parameter", "90 % interval"), rows)] if rows else []
        if diagnosis.checked:
            keys = ("nominal", "before", "after", "noise")
            heads = ("recording", "role", "nominal", "before", "after", "noise")
            errors = [
                [run["name"], run["role"], *(_error(run[f"nrmse_{key}"]) for key in keys)]
                for run in diagnosis.heldout["per_recording"]
            ]
            parts.append(_html_table(heads, errors))
        return "".join(parts)


def _error(value: float | None) -> str:
    return "cannot follow" if value is None else f"{value:.3g}"


def _html_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in heads)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


@checked(
    BadCase,
    case="make a case of a model and arrays: vlab.Case.from_arrays(MODEL, t, {ACTUATOR: array}, {SENSOR: array})",
)
def diagnose(
    case: Case | Path | str,
    *,
    effects: Sequence[Effect | str] | None = None,
    families: Sequence[str] | None = None,
    only: Sequence[str] | None = None,
    at: Sequence[str] | None = None,
    jobs: int | None = None,
    time_limit: float | None = None,
    progress: Progress = True,
) -> Diagnosis:
    """Find the physics that a model lacks.

    Parameters
    ----------
    case : Case, Path or str
        Case, or its file or folder.
    effects : sequence of Effect or str, optional
        Effects beside those of `families`: objects, ``"path/to/effect.py:CLASS"``, ``"entry:NAME"`` of an installed
        package, or names of the catalogue.
    families : sequence of str, optional
        Families of the catalogue that are searched, such as ``["friction"]``; ``[]`` for your own effects alone. The
        default is the whole catalogue.
    only : sequence of str, optional
        Effects of the catalogue that are searched, such as ``["coulomb-friction", "dead-band"]``, in place of `families`.
    at : sequence of str, optional
        Places at which effects are sought, such as ``["joint:elbow"]``; all places by default. A name without its kind
        means all places of that name.
    jobs : int, optional
        Most processes at a time; one a core by default.
    time_limit : float, optional
        Duration [s] after which no further effects are added; none by default.
    progress : bool or callable
        True shows a bar on a terminal. A function receives the completed share and the present step.

    Returns
    -------
    Diagnosis
        Verdict, findings, figures, report and extended model.

    Raises
    ------
    BadCase
        The case does not fit its model, or has nothing to fit.
    BadRecording
        A recording is damaged or contradicts the case.
    BadExperiment
        A setting is impossible, or two effects have one name.
    UnknownName
        No such family, effect or place.
    """
    if jobs is not None and jobs < 1:
        raise BadExperiment(f"jobs is {jobs}; give a whole number from 1, or None for one a core")
    if time_limit is not None and not time_limit > 0:
        raise BadExperiment(f"the time limit is {time_limit:g} s; give a positive number of seconds")
    candidates = candidate_effects(effects or (), families, only)
    case = case if isinstance(case, Case) else load_case(case)
    names = [at] if isinstance(at, str) else list(at or ())
    if names:
        check_places(case.plant, names)
    with limited_to(jobs), reported(progress, "diagnose") as report:
        done = run_pipeline(case, effects=candidates, at=names, progress=report, time_limit=time_limit)
    return Diagnosis(case, done)


def check_places(plant: Plant, names: Sequence[str]) -> None:
    """Refuse names of places that the model does not have.

    Parameters
    ----------
    plant : Plant
        Nominal model.
    names : sequence of str
        Names with or without their kind.

    Raises
    ------
    UnknownName
        No such place.
    """
    known = [*plant.ports, *(f"actuator:{a.name.removeprefix('coil:')}" for a in plant.actuators), "chain"]
    known += [f"sensor:{s.name.removeprefix('sensor:')}" for s in plant.sensors]
    if isinstance(plant, MjcfPlant):
        known += [f"body:{plant.model.body(i).name}" for i in range(1, plant.model.nbody)]
        known += [f"site:{plant.model.site(i).name}" for i in range(plant.model.nsite)]
    for name in names:
        if not any(is_named(place, [name]) for place in known):
            raise unknown_name("place", name, dict.fromkeys(known))


def candidate_effects(
    own: Sequence[Effect | str], families: Sequence[str] | None = None, only: Sequence[str] | None = None
) -> list[Effect]:
    """Return the effects that a diagnosis searches.

    Parameters
    ----------
    own : sequence of Effect or str
        Effects of the user.
    families : sequence of str or None
        Families of the catalogue; all by default.
    only : sequence of str or None
        Effects of the catalogue in place of families; may name effects of the user, which are searched in any case.

    Returns
    -------
    list of Effect
        Effects of the catalogue and of the user.

    Raises
    ------
    BadExperiment
        Two effects have one name, none is left, or families and effects are restricted together.
    UnknownName
        No such family or effect.
    """
    users = [given if isinstance(given, Effect) else effect_named(given, code=[code_of(given)]) for given in own]
    if only and families:
        raise BadExperiment("families and single effects are both restricted; give one of them")
    known = list(dict.fromkeys(effect.family for effect in CANDIDATES))
    if isinstance(families, str):
        families = [families]
    for family in families or ():
        if family not in known:
            raise unknown_name("family of effects", family, known)
    if only:
        names = [only] if isinstance(only, str) else only
        named = [effect_named(name, code=()) for name in names if name not in {effect.name for effect in users}]
        chosen = [effect for effect in dict.fromkeys(named) if effect.name in EFFECTS]
    else:
        chosen = [effect for effect in CANDIDATES if families is None or effect.family in families]
    for effect in users:
        others = chosen if effect is EFFECTS.get(effect.name) else [*EFFECTS.values(), *chosen]
        if effect.name in [other.name for other in others]:
            raise BadExperiment(f"there is another effect named {effect.name!r}; give yours a name of its own")
        chosen.append(effect)
    if not chosen:
        raise BadExperiment(f"no effect is left to search; families: {', '.join(known)}")
    return chosen
