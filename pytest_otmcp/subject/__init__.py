"""The subject under test: the launch of its adapters, and the tools that perform the operations."""

from __future__ import annotations

from .functions import Refused, ToolAnswer, Tools
from .load import load_subject, named_subject, reference_subject
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
    "named_subject",
    "reference_subject",
]
