"""What a method leaves to identify(): which options it has, and which of them are open."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, Protocol, runtime_checkable

AUTO = "auto"


@runtime_checkable
class HasHorizon(Protocol):
    """A method of past and future block rows; identify() chooses those left out."""

    @property
    def block_rows(self) -> int | None: ...

    @property
    def past_rows(self) -> int | None: ...


@runtime_checkable
class HasTransition(Protocol):
    """A method that finds A by regression of the states or by shift invariance."""

    @property
    def transition(self) -> str: ...


@runtime_checkable
class HasWeighting(Protocol):
    """A method that weighs the projection of the future on the past."""

    @property
    def weighting(self) -> str: ...


@runtime_checkable
class HasCompletion(Protocol):
    """A method that says how B, D and initial states are found."""

    @property
    def completion(self) -> str: ...


@runtime_checkable
class HasAlternatives(Protocol):
    """A method that offers other decompositions of the same factor to compare."""

    def alternatives(self, decomposition: Any) -> list[Any]: ...


def option_names(method: Any) -> set[str]:
    """Return the names of a method's options."""
    return {field.name for field in fields(method)}


def closed(method: Any, **wanted: str) -> Any:
    """Return the method with the wanted values of those options that are "auto"."""
    left = {field.name for field in fields(method) if vars(method)[field.name] == AUTO}
    changed = {name: value for name, value in wanted.items() if name in left}
    return replace(method, **changed) if changed else method


def leaves_horizon(method: Any) -> bool:
    """Tell whether the method has a horizon that is to be chosen."""
    return isinstance(method, HasHorizon) and method.block_rows is None


def rows_of(method: Any) -> int | None:
    """Return the block rows of the method; None where it has none."""
    return method.block_rows if isinstance(method, HasHorizon) else None


def weighting_of(method: Any) -> str:
    """Return the weighting of the method; empty where it has none."""
    return method.weighting if isinstance(method, HasWeighting) else ""


def completion_of(method: Any) -> str:
    """Return how the method wants models completed."""
    return method.completion if isinstance(method, HasCompletion) else AUTO


def leaves_transition(method: Any) -> bool:
    """Tell whether the better of regression and shift invariance is to be taken."""
    return isinstance(method, HasTransition) and method.transition == AUTO


def by_transition(method: Any) -> list[Any]:
    """Return the method with either transition where that is open, else the method itself."""
    if not leaves_transition(method):
        return [method]
    return [replace(method, transition=name) for name in ("regression", "shift")]
