"""The subject under test: how its adapters are started, and which of their tools performs which operation."""

from __future__ import annotations

from .functions import Refused, ToolAnswer, Tools
from .load import load_subject, reference_subject
from .model import Adapter, Binding, Deviation, Function, Subject, Variant

__all__ = [
    "Adapter",
    "Binding",
    "Deviation",
    "Function",
    "Refused",
    "Subject",
    "ToolAnswer",
    "Tools",
    "Variant",
    "load_subject",
    "reference_subject",
]
