"""Draft of a case: columns matched to a model, units and clock guessed with reasons, hold-outs picked."""

from vlab.cases.draft.draft import Draft, draft_case

__all__ = ["Draft", "draft_case"]
