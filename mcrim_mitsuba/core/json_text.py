"""Results as JSON: plain types, and the text of a file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import PurePath
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """The same in types that JSON has; numbers that are not finite become None.

    Dataclasses and mappings become dicts, sequences and arrays lists, paths text.

    Raises
    ------
    TypeError
        If it holds something else.
    """
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, PurePath):
        return str(value)
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    raise TypeError(f"JSON has nothing for a {type(value).__name__}")


def json_text(value: Any, indent: int | None = None) -> str:
    """JSON of a value, see `plain`; on one line without an indent."""
    return json.dumps(plain(value), indent=indent, ensure_ascii=False, allow_nan=False)
