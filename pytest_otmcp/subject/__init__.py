"""Who is tested, how it is started, and which of its tools performs which operation."""

from __future__ import annotations

from .load import load_subject, reference_subject
from .model import Adapter, Binding, Subject, Variant

__all__ = ["Adapter", "Binding", "Subject", "Variant", "load_subject", "reference_subject"]
