"""Run folder: settings in run.toml, recording, and manifest."""

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from vlab.controllers import Controller
from vlab.controllers.law_file import is_law_file
from vlab.controllers.user_law import code_of
from vlab.errors import BadExperiment, BadRecording
from vlab.fe import FeModel, build_fe_model
from vlab.files.containment import NotInside, file_inside
from vlab.files.output_folder import write_manifest
from vlab.files.toml import Reader
from vlab.hardware import Hardware, load_hardware
from vlab.hardware.interlock import Fault, power_up_as_told
from vlab.lab.excitation import Dwell, InTurn, Release, build_excitation, forces_at
from vlab.lab.experiment import Experiment, Result, run_experiment
from vlab.lab.given_law import LAW_FILE, GivenLaw
from vlab.lab.laws import named_law
from vlab.lab.model_bench import bench_excitation, bench_hardware, bench_law, bench_plant, check_settings, is_model_file
from vlab.physics.attach import attach
from vlab.physics.spec import parse_effect
from vlab.plants import Plant, build_plant
from vlab.plants.mjcf_guard import model_files
from vlab.recordings import read_recording, write_recording
from vlab.recordings.bound import RECORDING, STATED, check_run
from vlab.signals import Recording
from vlab.structure import load_structure
from vlab.structure.model import Structure
from vlab.structure.reader import BUILT_IN

SETTINGS = "run.toml"
"""File name of the settings."""
COPIES = {"structure": "structure.toml", "hardware": "hardware.toml", "law": LAW_FILE}
"""File name of each setting's copy in the run folder. A run folder's files are read from there only."""
MODEL = "model"
"""Folder of the copies of a user's MJCF file and of the files that the model names."""
MOST_NOISE = 1e3
"""MOST_NOISE [m/s]: largest noise of a velocity sensor; above it squares overflow."""


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """Settings that determine an experiment, as in `run.toml`.

    None means the default of the part.

    Attributes
    ----------
    is_data : bool
        Whether the settings come from a file and therefore run no code.
    """

    is_data: ClassVar[bool] = False

    structure: str
    plant: str = "composite"
    variant: str = "published"
    law: str = ""
    model: str = ""
    excite: str = "multisine"
    at: str = ""
    level: float | None = None
    low_hz: float | None = None
    high_hz: float | None = None
    period_s: float | None = None
    odd: bool | None = None
    seconds: float = 60.0
    rate_hz: float | None = None
    seed: int = 0
    noise: float = 0.0
    hardware: str = ""
    hardware_values: tuple[str, ...] = ()
    power_up: str = ""
    effect: tuple[str, ...] = ()

    @property
    def named_files(self) -> dict[str, str]:
        """Settings that name a data file, with the file."""
        files = {"structure": self.structure not in BUILT_IN, "hardware": self.hardware, "law": is_law_file(self.law)}
        return {key: getattr(self, key) for key, is_file in files.items() if is_file}

    @property
    def named_code(self) -> tuple[str, ...]:
        """Python files and entry points in the settings, see `code_of`."""
        names = (self.law, *(text.partition("@")[0].strip() for text in self.effect))
        return tuple(filter(None, map(code_of, names)))

    def inside(self, folder: Path) -> "RunSettings":
        """Return the settings with a run folder's own copies.

        Parameters
        ----------
        folder : Path
            Run folder; no file outside is read.

        Returns
        -------
        RunSettings
            Settings.

        Raises
        ------
        BadRecording
            A copy is missing or leads out of the folder.
        """
        found: dict[str, Any] = {}
        for key, given in self.named_files.items():
            copy = self._copy_of(key)
            try:
                found[key] = str(file_inside(copy, folder))
            except NotInside as error:
                raise BadRecording(
                    f"{folder / SETTINGS}: {key} = {given!r} is read from {copy} in the run folder, which {error}; "
                    "copy it there under that name"
                ) from error
        return replace(self, **found)

    @property
    def is_own_model(self) -> bool:
        """Whether the bench is a user's MJCF model."""
        return is_model_file(self.structure)

    def _copy_of(self, key: str) -> str:
        """Return the place of a file's copy in the run folder."""
        is_model = key == "structure" and self.is_own_model
        return f"{MODEL}/{Path(self.structure).name}" if is_model else COPIES[key]

    def copy_files(self, folder: Path, *, except_law: bool = False) -> None:
        """Copy all named files into a run folder.

        Parameters
        ----------
        folder : Path
            Run folder.
        except_law : bool
            Whether the law is no file, but an object.
        """
        for key, name in self.named_files.items():
            if key == "law" and except_law:
                continue
            if key == "structure" and self.is_own_model:
                source = Path(name).resolve()
                for file in model_files(source, name):
                    target = folder / MODEL / file.relative_to(source.parent)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(file, target)
            else:
                shutil.copyfile(name, folder / self._copy_of(key))

    def prepare(self, *, code: Collection[str] = (), given: GivenLaw | None = None) -> "PreparedRun":
        """Build every part, so that an error precedes the run.

        Parameters
        ----------
        code : collection of str
            Python files and entry points that the user named; settings from a file may name one of them.
        given : GivenLaw or None
            Law that exists as an object, in place of the law by name.

        Returns
        -------
        PreparedRun
            Prepared run.
        """
        if given is not None:
            return replace(self, law=given.name)._prepare(code, given)
        return self._prepare(code, None)

    def _prepare(self, code: Collection[str], given: GivenLaw | None) -> "PreparedRun":
        code = [*code, *(() if self.is_data else self.named_code)]
        if not 0 <= self.noise <= MOST_NOISE:
            raise BadExperiment(
                f"the noise {self.noise} m/s is negative, not finite or beyond reason; accepted: 0 to {MOST_NOISE:g}"
            )
        if self.seed < 0:
            raise BadExperiment(f"the seed {self.seed} is negative; accepted: whole numbers from 0")
        if self.is_own_model:
            return self._prepare_own(code, given)
        structure = load_structure(self.structure)
        hardware = load_hardware(self.hardware or None, self.hardware_values)
        if self.rate_hz is not None:
            hardware = hardware.at_rate(self.rate_hz)
        if self.noise > 0:
            hardware = replace(hardware, velocity_sensor=replace(hardware.velocity_sensor, noise=self.noise))
        excitation = self._excitation(hardware)
        faults: tuple[Fault, ...] = ()
        if self.power_up:
            switches = power_up_as_told(hardware, self.power_up)
            hardware, faults = switches.bench(), tuple(switches.faults)
        if self.model and given is not None:
            raise BadExperiment(f"the law is made already: the model {self.model!r} is for laws that are designed here")
        if self.model and not self.law:
            raise BadExperiment(f"the model {self.model!r} is what a law is designed on; name the law, too")
        rate = hardware.converter.rate
        law = None
        if self.law and given is None:
            law = named_law(structure, self.law, rate=rate, variant=self.variant, model=self.model, code=code)
        plant = build_plant(structure, self.plant, self.variant)
        law = law if given is None else given.for_plant(plant)
        plant = attach(plant, [parse_effect(text, code=code) for text in self.effect])
        plant.substeps(hardware.converter.rate)
        at = self.at or structure.exciter
        places = [plant.actuator_index(place) for place in at.split(",")]
        if len(places) > 1 and not isinstance(excitation, (Dwell, Release)):
            excitation = InTurn(signal=excitation, actuators=len(places), turn_s=self.seconds / len(places))
        forces_at(excitation, np.zeros(1), len(places))
        return self._prepared(structure, hardware, plant, (law, given), (excitation, at), faults)

    def _excitation(self, hardware: Hardware) -> Any:
        """Return the excitation of a run on a structure."""
        release = self.excite == "release"
        excitation = build_excitation(
            self.excite,
            level=self.level,
            low_hz=self.low_hz,
            high_hz=self.high_hz,
            period_s=self.period_s,
            odd=self.odd,
            seed=None if release else self.seed,
        )
        if not release and self.high_hz is not None and self.high_hz > hardware.converter.rate / 2:
            raise BadExperiment(
                f"the band reaches {self.high_hz:g} Hz; a converter of {hardware.converter.rate:g} Hz drives and records up to "
                f"{hardware.converter.rate / 2:g} Hz"
            )
        return excitation

    def _prepare_own(self, code: Collection[str], given: GivenLaw | None) -> "PreparedRun":
        """Build a run on a user's model."""
        check_settings(self)
        plant = bench_plant(self.structure)
        hardware = bench_hardware(self, plant.timestep)
        if self.noise > 0:
            coil = replace(hardware.velocity_sensor, noise=self.noise)
            probe = replace(hardware.displacement_probe, noise=self.noise)
            hardware = replace(hardware, velocity_sensor=coil, displacement_probe=probe)
        plant.substeps(hardware.converter.rate)
        if given is not None:
            law: Controller | None = given.for_plant(plant)
        else:
            law = bench_law(self.law, code=code) if self.law else None
        excitation = bench_excitation(self, plant, hardware.converter.rate)
        changed = attach(plant, [parse_effect(text, code=code) for text in self.effect])
        return self._prepared(None, hardware, changed, (law, given), excitation, ())

    def _prepared(
        self,
        structure: Structure | None,
        hardware: Hardware,
        plant: Plant,
        law: tuple[Controller | None, GivenLaw | None],
        excitation: tuple[Any, str],
        faults: tuple[Fault, ...],
    ) -> "PreparedRun":
        experiment = Experiment(
            plant=plant,
            seconds=self.seconds,
            excitation=excitation[0],
            excite=excitation[1],
            controller=law[0],
            hardware=hardware,
            seed=self.seed,
        )
        return PreparedRun(
            settings=self,
            structure=structure,
            hardware=hardware,
            plant=plant,
            law=law[0],
            given=law[1],
            experiment=experiment,
            faults=faults,
        )

    def to_toml(self) -> str:
        """Return the settings as TOML.

        JSON's numbers, strings and truth values are valid TOML.
        """
        lines = [f"{key} = {json.dumps(value)}" for key, value in asdict(self).items() if value is not None]
        return "\n".join(lines) + "\n"


class StoredSettings(RunSettings):
    """Settings from a file, which run no code."""

    is_data = True


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedRun:
    """A run with all parts built.

    `structure` is None for a user's model. `given` is the law of an object, else None. `faults` lists events at switch-on. A concealed run writes nothing on the
    effects in its plant.
    """

    settings: RunSettings
    structure: Structure | None
    hardware: Hardware
    plant: Plant
    law: Controller | None
    experiment: Experiment
    given: GivenLaw | None = None
    faults: tuple[Fault, ...] = ()
    is_concealed: bool = False

    def concealed(self) -> "PreparedRun":
        """Return the run with its effects concealed."""
        return replace(self, settings=replace(self.settings, effect=()), is_concealed=True)

    @property
    def title(self) -> str:
        """Title of the structure, or file name of the user's model."""
        return Path(self.settings.structure).name if self.structure is None else self.structure.title

    def fe_model(self) -> FeModel:
        """Return the FE model of the run's variant.

        Raises
        ------
        BadExperiment
            A user's model has no FE model.
        """
        if self.structure is None:
            raise BadExperiment(f"{self.title}: only beam, grid and structure files have an FE model")
        return build_fe_model(self.structure, self.settings.variant)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DoneRun:
    """A completed run."""

    prepared: PreparedRun
    result: Result
    elapsed_s: float

    def __repr__(self) -> str:
        """Return structure, law and channels in one line."""
        settings = self.prepared.settings
        law = f" under {settings.law}" if settings.law else ""
        names = ", ".join(self.recording.names)
        return f"<DoneRun of {settings.structure}{law}: {settings.seconds:g} s of {settings.excite}; {names}>"

    @property
    def recording(self) -> Recording:
        """All channels of the run, in SI."""
        return self.result.recording

    @property
    def real_time_factor(self) -> float:
        """Simulated time over elapsed time."""
        return self.prepared.settings.seconds / self.elapsed_s

    @property
    def effort(self) -> dict[str, dict[str, Any]]:
        """Effort of every actuator by place, as plain data."""
        return {part.at: part.as_dict() for part in self.result.effort}

    def write(self, folder: Path) -> None:
        """Write recording and settings, without the manifest."""
        write_recording(self.recording, folder / RECORDING)
        (folder / SETTINGS).write_text(self.prepared.settings.to_toml(), encoding="utf-8")
        given, law = self.prepared.given, self.prepared.law
        self.prepared.settings.copy_files(folder, except_law=given is not None)
        if given is not None and law is not None:
            given.write(folder, law)

    def finish(self, folder: Path) -> None:
        """Write the manifest after all further files."""
        digest = hashlib.sha256((folder / RECORDING).read_bytes()).hexdigest()
        write_manifest(
            folder,
            verb="experiment",
            settings=asdict(self.prepared.settings),
            **{STATED: digest},
            faults=[asdict(fault) for fault in self.prepared.faults],
            effort=self.effort,
            **({} if self.prepared.is_concealed else {"elapsed_s": self.elapsed_s}),  # would reveal effects
        )


def perform(
    prepared: PreparedRun,
    folder: Path,
    *,
    progress: Callable[[float], None] | None = None,
    watch: Callable[[float, Callable[[], Result]], None] | None = None,
) -> DoneRun:
    """Run a prepared experiment and write its folder.

    `run_experiment` describes the callbacks.

    Parameters
    ----------
    prepared : PreparedRun
        Prepared run.
    folder : Path
        Output folder.
    progress : callable or None
        Called with the simulated seconds done.
    watch : callable or None
        Called with the simulated seconds done and a function that returns the result so far.

    Returns
    -------
    DoneRun
        Completed run.
    """
    done = simulate_run(prepared, progress=progress, watch=watch)
    done.write(folder)
    return done


def simulate_run(
    prepared: PreparedRun,
    *,
    progress: Callable[[float], None] | None = None,
    watch: Callable[[float, Callable[[], Result]], None] | None = None,
) -> DoneRun:
    """Run a prepared experiment in memory.

    `run_experiment` describes the callbacks.

    Parameters
    ----------
    prepared : PreparedRun
        Prepared run.
    progress : callable or None
        Called with the simulated seconds done.
    watch : callable or None
        Called with the simulated seconds done and a function that returns the result so far.

    Returns
    -------
    DoneRun
        Completed run.
    """
    begun = time.perf_counter()
    result = run_experiment(prepared.experiment, progress=progress, watch=watch)
    elapsed = time.perf_counter() - begun
    facts = {key: value for key, value in asdict(prepared.settings).items() if value is not None}
    facts |= {key: "; ".join(facts[key]) for key in ("effect", "hardware_values")}
    recording = replace(result.recording, meta={**facts, **result.recording.meta})
    return DoneRun(prepared=prepared, result=replace(result, recording=recording), elapsed_s=elapsed)


def load_run(path: Path | str) -> tuple[Recording, RunSettings | None]:
    """Load a run folder or a recording file.

    Parameters
    ----------
    path : Path or str
        Run folder or recording file.

    Returns
    -------
    tuple of (Recording, RunSettings or None)
        Recording, and settings (None for a file).

    Raises
    ------
    BadRecording
        The path is neither, the recording is damaged, or its hash differs from the manifest's.
    """
    path = Path(path)
    if not path.is_dir():
        return read_recording(path), None
    check_run(path)
    try:
        file_inside(SETTINGS, path)
    except NotInside as error:
        raise BadRecording(f"{path / SETTINGS}: the file {error}; restore the run folder") from error
    reader = Reader(path / SETTINGS, provenance_required=False, error=BadRecording)
    whole = path.absolute()  # a relative path would refer to the folder
    return read_recording(whole / RECORDING, folder=whole), reader.table(StoredSettings, reader.load())
