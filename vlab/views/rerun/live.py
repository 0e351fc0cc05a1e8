"""Live view of a run in a Rerun viewer."""

import contextlib
import math
import time
import uuid
from collections.abc import Callable
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vlab.errors import BadExperiment
from vlab.lab.experiment import Result
from vlab.lab.run_folder import PreparedRun
from vlab.signals import Recording
from vlab.views.rerun.control_law import LawScene
from vlab.views.rerun.documents import fact_list, log_document, run_facts
from vlab.views.rerun.frames import Motion
from vlab.views.rerun.modes import ModalScene
from vlab.views.rerun.rrd import APPLICATION, arranged, blueprint
from vlab.views.rerun.spectra import SpectrumScene
from vlab.views.rerun.structure import StructureScene
from vlab.views.rerun.traces import log_traces, trace_views

PICTURES_HZ = 30.0
"""PICTURES_HZ [Hz]: update rate of a paced run."""
REST_S = 0.2
"""REST_S [s]: least time between two parts of an unpaced run, which keeps the cost low."""
LEAVE_S = 10.0
"""LEAVE_S [s]: longest time for the last part to arrive."""
HIGHEST_HZ = 60.0
"""HIGHEST_HZ [Hz]: last line of the spectra for an excitation without a band."""


class LiveView:
    """Live view of a run, with `watch` for `vlab.lab.experiment.run_experiment`.

    The first part sets all constants, among them the factor on the deflections. The factor falls when the motion
    outgrows the picture. The document states the present factor.

    Parameters
    ----------
    connect : callable
        Returns the address of a viewer, see `vlab.views.rerun.viewer.viewer_at`; called at once.
    pace : float
        Most simulated seconds per second; infinity for no limit.

    Raises
    ------
    BadExperiment
        The pace is not positive.
    """

    def __init__(self, prepared: PreparedRun, *, connect: Callable[[], str], pace: float = 1.0) -> None:
        if math.isnan(pace) or pace <= 0:
            raise BadExperiment(f"the pace {pace:g} is not a positive number of simulated seconds a second")
        self.prepared, self.pace, self.address = prepared, pace, connect()
        if prepared.structure is None:
            raise BadExperiment(
                f"{prepared.title}: the live view shows beam, grid and structure files; leave --live out, then vlab show"
            )
        self._structure = prepared.structure
        self._stream = rr.RecordingStream(APPLICATION, recording_id=uuid.uuid4(), send_properties=False)
        self._begun: float | None = None
        self._last = -math.inf
        self._samples = self._frames = 0
        self._scenes: tuple[ModalScene, SpectrumScene, LawScene] | None = None
        self._factor: float | None = None
        self._largest: dict[str, float] = {}

    def watch(self, done_s: float, so_far: Callable[[], Result]) -> None:
        """Send new samples, and wait for the pace.

        Parameters
        ----------
        done_s : float
            Completed simulated time [s].
        so_far : callable
            Returns the result, complete up to `done_s`.
        """
        now = time.monotonic()
        self._begun = now if self._begun is None else self._begun
        if math.isinf(self.pace):
            if now >= self._last + REST_S:
                self._send(so_far(), done_s)
                self._last = now
            return
        result = so_far()
        while True:
            due = (time.monotonic() - self._begun) * self.pace
            self._send(result, min(due, done_s))
            if due >= done_s:
                return
            time.sleep(1 / PICTURES_HZ)

    def finish(self, result: Result) -> None:
        """Send the rest and disconnect."""
        self._send(result, math.inf)
        with contextlib.suppress(RuntimeError):
            self._stream.flush(timeout_sec=LEAVE_S)
        self._stream.disconnect()

    def _send(self, result: Result, until_s: float) -> None:
        recording = result.recording
        samples = int(np.searchsorted(recording.time, until_s, side="left"))
        frames = int(np.searchsorted(result.frame_times, until_s, side="left"))
        if samples <= self._samples or frames <= self._frames:
            return
        motion = Motion.of(self._structure, self.prepared.plant, result, since=self._frames, until=frames)
        first = self._scenes is None
        scene = self._picture(motion, recording)
        if self._scenes is None:
            self._scenes = self._open(result, scene)
        modes, spectra, inside = self._scenes
        stream = self._stream if first else _Moving(self._stream)
        part: dict[str, Any] = {"since": self._samples, "until": samples}
        scene.log(stream)
        for channel in (c.name for c in recording.channels if c.kind == "force"):
            new = float(np.abs(recording[channel][self._samples : samples]).max())
            self._largest[channel] = max(new, self._largest.get(channel, 0.0))
        scene.log_forces(stream, recording, self._largest)
        modes.log(stream, result, since=self._frames, until=frames)
        log_traces(stream, recording, **part)
        spectra.log(stream, recording, **part)
        inside.log(stream, recording, **part)
        self._samples, self._frames = samples, frames

    def _picture(self, motion: Motion, recording: Recording) -> StructureScene:
        """Return the structure with the present factor."""
        scene = StructureScene(self._structure, motion)
        if self._factor is not None and scene.factor > self._factor / 2:
            return StructureScene(self._structure, motion, self._factor)
        self._factor = scene.factor
        if self._scenes is not None:
            self._document(scene, recording)
        return scene

    def _open(self, result: Result, scene: StructureScene) -> tuple[ModalScene, SpectrumScene, LawScene]:
        prepared, recording = self.prepared, result.recording
        high = prepared.settings.high_hz or HIGHEST_HZ
        scenes = (
            ModalScene(self._structure, prepared.plant),
            SpectrumScene(recording, highest_hz=1.2 * high),
            LawScene(prepared.plant, recording, prepared.hardware, prepared.law),
        )
        modes, spectra, inside = scenes
        pages = [("traces", trace_views(recording)), ("spectra", spectra.views()), ("controller", inside.views())]
        papers = [rrb.TextDocumentView(name="facts", origin="/facts")]
        title = f"{self._structure.title}, live"
        layout = blueprint(arranged(scene.view(title), modes.view(), pages, papers), playing="following")
        self._stream.connect_grpc(self.address, default_blueprint=layout)
        self._stream.send_recording_name(title)
        self._document(scene, recording)
        return scenes

    def _document(self, scene: StructureScene, recording: Recording) -> None:
        """Log the document, in place of an earlier one."""
        prepared = self.prepared
        facts = run_facts(prepared.plant, recording, prepared.settings.law, prepared.hardware)
        facts["picture"] = f"{scene.title()}; arrows: forces of the coils, the longest is the largest until then"
        log_document(self._stream, fact_list(f"{self._structure.title}, live", facts))


class _Moving:
    """Stream of moving data only."""

    def __init__(self, stream: Any) -> None:
        self.send_columns = stream.send_columns

    def log(self, *_: Any, **__: Any) -> None:
        """Drop static data."""
