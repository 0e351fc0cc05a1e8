"""Bodies of a MuJoCo model in a Rerun scene, to scale."""

from typing import Any

import mujoco
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from vlab.lab.experiment import Result
from vlab.plants.base import Plant
from vlab.views.rerun.frames import configurations, frame_columns
from vlab.views.rerun.rrd import LIGHT, PURPLE, eye_view, send

LABELS = 12
"""LABELS [-]: most bodies with a name label."""


class BodyScene:
    """Scene of the bodies of any model."""

    def __init__(self, plant: Plant, result: Result) -> None:
        self.model, self.name = plant.model, model_name(plant)
        self.indexes = frame_columns(result)
        n, model = len(result.frames), plant.model
        endless = {int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)}
        self.geoms = np.array([i for i in range(model.ngeom) if int(model.geom_type[i]) not in endless], dtype=int)
        box = model.geom_aabb.reshape(-1, 6)[self.geoms]
        halves = np.sort(box[:, 3:], axis=1)
        self.radii = np.sqrt(halves[:, 0] * halves[:, 1])  # of a rod of the same section
        reach = np.maximum(halves[:, 2] - self.radii, 1e-3 * halves[:, 2])
        along = np.eye(3)[np.argmax(box[:, 3:], axis=1)] * reach[:, None]
        ends = np.stack([box[:, :3] - along, box[:, :3] + along], axis=1)
        self.bodies = np.empty((n, model.nbody, 3), dtype=np.float32)
        self.centres, self.sites = np.empty_like(self.bodies), np.empty((n, model.nsite, 3), dtype=np.float32)
        self.rods = np.empty((n, len(self.geoms), 2, 3), dtype=np.float32)
        data = plant.new_data()
        for k, _ in enumerate(configurations(plant, data, result.frames)):
            self.bodies[k], self.centres[k], self.sites[k] = data.xpos, data.xipos, data.site_xpos
            turn = data.geom_xmat[self.geoms].reshape(-1, 3, 3)
            self.rods[k] = data.geom_xpos[self.geoms][:, None] + np.einsum("gij,gej->gei", turn, ends)
        shown = np.concatenate([a.reshape(-1, 3) for a in (self.bodies[:, 1:], self.centres[:, 1:], self.rods)])
        self.low, self.high = shown.min(axis=0, initial=np.inf), shown.max(axis=0, initial=-np.inf)
        self.size = float(np.linalg.norm(self.high - self.low)) or 1.0

    def log(self, stream: Any) -> None:
        """Log the bodies and their motion."""
        stream.log("bodies", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        parents = self.model.body_parentid
        inner = [b for b in range(1, self.model.nbody) if parents[b] > 0]
        links = np.stack([self.bodies[:, parents[inner]], self.bodies[:, inner]], axis=2)
        arms = np.stack([self.bodies[:, 1:], self.centres[:, 1:]], axis=2)
        self._lines(stream, "links", np.concatenate([links, arms], axis=1), LIGHT, 0.003 * self.size)
        colours = (255 * self.model.geom_rgba[self.geoms]).astype(np.uint8)
        self._lines(stream, "geoms", self.rods, colours, self.radii)
        labels = [mujoco.mj_id2name(self.model, mujoco.mjtObj.mjOBJ_BODY, b) or "" for b in range(1, self.model.nbody)]
        self._dots(stream, "joints", self.bodies[:, 1:], LIGHT, 0.008, labels if len(labels) <= LABELS else None)
        self._dots(stream, "sites", self.sites, PURPLE, 0.005, None)

    def _lines(self, stream: Any, name: str, strips: NDArray[np.float32], colours: Any, radii: Any) -> None:
        n, count = strips.shape[:2]
        if count:
            look = rr.LineStrips3D.from_fields(colors=colours, radii=radii)
            columns = rr.LineStrips3D.columns(strips=strips.reshape(n * count, 2, 3)).partition([count] * n)
            send(stream, f"bodies/{name}", self.indexes, look, columns)

    def _dots(
        self, stream: Any, name: str, positions: NDArray[np.float32], colour: Any, share: float, labels: Any
    ) -> None:
        n, count = positions.shape[:2]
        if count:
            look = rr.Points3D.from_fields(colors=[colour], radii=[share * self.size], labels=labels)
            columns = rr.Points3D.columns(positions=positions.reshape(-1, 3)).partition([count] * n)
            send(stream, f"bodies/{name}", self.indexes, look, columns)

    def view(self) -> Any:
        """Return the view of the bodies."""
        return eye_view(f"{self.name}, true motion", "/bodies", (self.low + self.high) / 2, self.size)


def model_name(plant: Plant) -> str:
    """Return the name of the MuJoCo model, or else of the plant."""
    return str(getattr(plant.spec, "modelname", "") or plant.name)
