"""Compilation where nothing can be cached."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import pytest

from mobo_tuner.core.compilation import compiled


def doubled(value: float) -> float:
    return 2.0 * value


def test_without_a_place_for_the_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    njit: Callable[..., Any] = numba.njit

    def no_locator(*args: Any, cache: bool = False, **options: Any) -> Any:
        if cache:

            def refuse(_: object) -> None:
                raise RuntimeError("cannot cache function: no locator available")

            return refuse
        return njit(*args, **options)

    monkeypatch.setattr(numba, "njit", no_locator)
    assert compiled(doubled)(21.0) == 42.0
