"""Peers by name, and their results on one case."""

import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

from vlab.cases.case import Case
from vlab.errors import unknown_name
from vlab.proof.peers.bic import bic_over_catalogue
from vlab.proof.peers.friction_models import fit_friction_models
from vlab.proof.peers.mujoco_sysid import fit_all_numbers
from vlab.proof.peers.result import NotUsable, PeerResult
from vlab.proof.peers.sparse_regression import sparse_regression


@dataclass(frozen=True, kw_only=True)
class Peer:
    """Method beside the diagnosis.

    Parameters
    ----------
    run : callable
        Function from a case to a result.
    is_slow : bool
        Whether a case takes many minutes.
    """

    run: Callable[[Case], PeerResult]
    is_slow: bool = True


PEERS: dict[str, Peer] = {
    "pysindy": Peer(run=sparse_regression, is_slow=False),
    "mujoco.sysid": Peer(run=fit_all_numbers),
    "friction-models": Peer(run=fit_friction_models),
    "bic": Peer(run=bic_over_catalogue),
}
"""PEERS: peers by name."""


def check_peers(names: Collection[str]) -> None:
    """Refuse an unknown peer."""
    for name in names:
        if name not in PEERS:
            raise unknown_name("peer", name, PEERS)


def peers_of(case: Case, names: Collection[str] = (), *, slow_too: bool = True) -> dict[str, dict[str, Any]]:
    """Return the results of peers on a case.

    A result names at most one effect and holds the held-out error and the CPU time. In place of a result stands its
    reason where a peer cannot treat the case, or fails.

    Parameters
    ----------
    case : Case
        Case.
    names : collection of str
        Peers; all by default.
    slow_too : bool
        Whether the slow peers run.

    Returns
    -------
    dict
        Plain values by peer.
    """
    chosen = {name: peer for name, peer in PEERS.items() if not names or name in names}
    return {name: _answered(peer, case) for name, peer in chosen.items() if slow_too or not peer.is_slow}


def _answered(peer: Peer, case: Case) -> dict[str, Any]:
    """Return a peer's result, or its failure, with the CPU time."""
    began = time.process_time()
    try:
        found = peer.run(case).to_json()
    except NotUsable as reason:
        found = {"note": f"not run: {reason}"}
    except Exception as error:  # a fault of a peer is its result, and does not stop a campaign
        found = {"note": f"failed: {type(error).__name__}: {' '.join(str(error).split())}"}
    return {**found, "cpu_seconds": time.process_time() - began}
