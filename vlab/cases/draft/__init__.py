"""Draft of a case from a model and its logs."""

from vlab.cases.draft.draft import Draft, draft_case

__all__ = ["Draft", "draft_case"]
