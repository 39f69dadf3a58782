"""What an identification returns, and the contract that every method keeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from .chunks import Segment, Stream
from .errors import OptionError
from .gram import BlockGram
from .record import Channel, Floats, Record
from .scores import InitialRule, initial_state
from .statespace import StateSpace, as_inputs

Severity = Literal["note", "doubt", "warning"]


@dataclass(frozen=True)
class Finding:
    """One thing that a user should know: what was seen, how bad it is, what to do."""

    code: str
    severity: Severity
    sentence: str
    cure: str = ""

    def __str__(self) -> str:
        return f"{self.sentence} {self.cure}".strip()


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """Figures by name, and findings: the one place for warnings."""

    figures: Mapping[str, Any] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()

    def joined(self, figures: Mapping[str, Any], findings: Sequence[Finding] = ()) -> Diagnostics:
        """Return the diagnostics with more figures and findings."""
        return Diagnostics({**self.figures, **figures}, (*self.findings, *findings))


@dataclass(frozen=True, eq=False)
class Fit:
    """An identified model with its evidence; complete when made.

    Attributes
    ----------
    model : StateSpace
        Discrete, with the record's dt and units.
    kalman_gain : array (n, n_outputs)
        Zero where the data hold no noise to learn it from (a finding says so).
    innovation_covariance : array (n_outputs, n_outputs)
        Of the one-step prediction errors; (0, 0) of a realization of responses.
    initial_states : array (n_segments, n)
        One per contiguous piece, at its first sample; NaN where not estimated.
    segments : tuple of Segment
        (record, start, stop) of each piece.
    input_offset, output_offset : array
        The model relates inputs less `input_offset` to outputs less `output_offset`; of
        several records, the mean over their samples.
    feedthrough : array of bool (n_outputs,)
        Which outputs have direct transmission; the rows of D of the others are zero.
    method : the method's dataclass, with every option as it was used
    order : int
    singular_values : array
        Of the method's Hankel or projected matrix.
    state_covariance : array (n, n)
        Of the states on the identification record: the prior of initial states elsewhere;
        (0, 0) of a realization of responses.
    parameter_covariance : array or None
    diagnostics : Diagnostics
    gram : BlockGram or None
    input_channels, output_channels : tuple of Channel
    """

    model: StateSpace
    kalman_gain: Floats
    innovation_covariance: Floats
    initial_states: Floats
    segments: tuple[Segment, ...]
    input_offset: Floats
    output_offset: Floats
    feedthrough: NDArray[np.bool_]
    method: Any
    order: int
    singular_values: Floats
    state_covariance: Floats
    parameter_covariance: Floats | None
    diagnostics: Diagnostics
    gram: BlockGram | None
    input_channels: tuple[Channel, ...]
    output_channels: tuple[Channel, ...]

    def __repr__(self) -> str:
        return (
            f"<Fit: order {self.order} by {self.method}, {self.model.n_inputs} inputs, "
            f"{self.model.n_outputs} outputs, dt={self.model.dt:g} s>"
        )

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Inputs, then outputs."""
        return self.input_channels + self.output_channels

    def simulate(
        self,
        inputs: Any = None,
        initial_state: Any = None,
        *,
        n_samples: int | None = None,
    ) -> Floats:
        """Return the outputs that the inputs alone would give, offsets included.

        Parameters
        ----------
        inputs : array (n_samples, n_inputs), optional
            In the record's units; zero when left out.
        initial_state : array (n,), optional
            At the first sample; zero by default.
        n_samples : int, optional
            Needed when there are no inputs.

        Returns
        -------
        array (n_samples, n_outputs)
        """
        u = np.asarray(as_inputs(inputs, n_samples, self.model.n_inputs)) - self.input_offset
        y = self.model.simulate(u, initial_state)
        return np.asarray(y + self.output_offset)

    def predict(
        self,
        record: Record,
        initial: InitialRule | Floats = "map",
        *,
        output_offset: Floats | None = None,
    ) -> Floats:
        """Return one-step-ahead predictions of the record's outputs.

        Parameters
        ----------
        record : Record
            With the channels of the identification record.
        initial : "map", "least_squares", "zero" or array (n_segments, n)
            How the initial state of each piece is found, or the states themselves; rows of
            NaN among them are found by MAP.
        output_offset : array (n_outputs,), optional
            Of this record, where records differ; the fit's own by default.

        Returns
        -------
        array (n_samples, n_outputs)
            NaN where samples are missing.
        """
        return self._run(record, self.predictor(), initial, output_offset)

    def simulate_record(
        self,
        record: Record,
        initial: InitialRule | Floats = "map",
        *,
        output_offset: Floats | None = None,
    ) -> Floats:
        """Return the outputs simulated from the record's inputs, piece by piece.

        The initial state of each piece is found by the named rule with the same model.
        Parameters and result as for `predict`.
        """
        none = np.zeros_like(self.kalman_gain)
        return self._run(record, self.predictor(none), initial, output_offset)

    def predictor(self, gain: Floats | None = None) -> StateSpace:
        """Return x̂⁺ = (A − K C) x̂ + [B − K D, K] [u; y], ŷ = C x̂ + [D, 0] [u; y]."""
        K = self.kalman_gain if gain is None else gain
        A, B, C, D = self.model.A, self.model.B, self.model.C, self.model.D
        return StateSpace(
            A - K @ C,
            np.hstack([B - K @ D, K]),
            C,
            np.hstack([D, np.zeros((len(C), len(C)))]),
            self.model.dt,
        )

    def _run(
        self,
        record: Record,
        predictor: StateSpace,
        initial: InitialRule | Floats,
        output_offset: Floats | None,
    ) -> Floats:
        self.check_channels(record)
        predicted = np.full((record.n_samples, record.n_outputs), np.nan)
        offset = self.output_offset if output_offset is None else np.asarray(output_offset, float)
        centre = np.concatenate([self.input_offset, offset])
        pieces = record.segments()
        if not isinstance(initial, str):
            initial = np.asarray(initial, dtype=np.float64)
            if initial.shape != (len(pieces), self.order):
                raise OptionError(
                    f"initial must hold {self.order} states for each of the {len(pieces)} pieces "
                    f"of the record; got shape {initial.shape}."
                )
        for k, (start, stop) in enumerate(pieces):
            z = record.read(start, stop) - centre
            state = self._initial(predictor, z, initial if isinstance(initial, str) else initial[k])
            predicted[start:stop] = predictor.simulate(z, state) + offset
        return predicted

    def _initial(self, predictor: StateSpace, z: Floats, initial: InitialRule | Floats) -> Floats:
        if not isinstance(initial, str):
            if not np.isnan(initial).any():
                return initial
            initial = "map"
        # of a realization of responses both are unknown, arrays without size
        return initial_state(
            predictor,
            z,
            z[:, self.model.n_inputs :],
            initial,
            self.innovation_covariance if self.innovation_covariance.size else None,
            self.state_covariance if self.state_covariance.size else None,
        )

    def check_channels(self, record: Record) -> None:
        """Raise `OptionError` unless the record's channels and rate are this fit's."""
        counts = (record.n_inputs, record.n_outputs)
        if counts != (self.model.n_inputs, self.model.n_outputs):
            raise OptionError(
                f"The model has {self.model.n_inputs} inputs and {self.model.n_outputs} outputs; "
                f"the record has {counts[0]} and {counts[1]}. Select the same channels."
            )
        names = [channel.name for channel in self.channels]
        given = [*record.input_names, *record.output_names]
        if names != given and sorted(names) == sorted(given):
            raise OptionError(
                f"The model's channels are {', '.join(names)}; the record has them as "
                f"{', '.join(given)}. Bring them into the model's order with select()."
            )
        if self.model.dt is not None and abs(record.dt - self.model.dt) > 1e-6 * record.dt:
            raise OptionError(
                f"The model's sampling interval is {self.model.dt:g} s, the record's "
                f"{record.dt:g} s; decimate the record as the identified one was."
            )


class Decomposition(Protocol):
    """The expensive half of a method: all orders follow from it without the data."""

    @property
    def method(self) -> Any:
        """The method with every option as it was used."""
        ...

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why options that were left out became what they are."""
        ...

    @property
    def findings(self) -> tuple[Finding, ...]: ...
    @property
    def criterion_decides(self) -> bool:
        """Whether errors are white enough for the criterion to have its minimum at the order."""
        ...

    @property
    def n_columns(self) -> int: ...
    @property
    def largest_order(self) -> int: ...
    @property
    def rank_limited(self) -> bool:
        """Whether the data hold nothing but rounding beyond the largest order."""
        ...

    @property
    def singular_values(self) -> Floats: ...
    @property
    def gram(self) -> BlockGram | None: ...
    def criterion(self, order: int) -> tuple[float, bool]:
        """Return the information criterion of this order, and whether it is stable."""
        ...

    def factors(self, order: int) -> tuple[Floats, Floats | None]:
        """Return observability and, where known, controllability from the data.

        In the coordinates of the order's model, outputs scaled by positive weights.
        """
        ...


class Method(Protocol):
    """A frozen dataclass whose fields are its options; one file, one line in METHODS.

    A horizon called `block_rows` is chosen by `identify` where it is None; other sizes are
    chosen by `decompose`, which says why.
    """

    def decompose(
        self,
        data: Record | Sequence[Record] | Stream,
        *,
        offset: str = "estimate",
        feedthrough: bool | Sequence[bool] | None = None,
        gram: BlockGram | None = None,
    ) -> Any: ...

    def realize(self, decomposition: Any, order: int) -> Fit: ...


def feedthrough_mask(
    feedthrough: bool | Sequence[bool] | None, channels: Sequence[Channel]
) -> NDArray[np.bool_]:
    """Return which outputs may have direct transmission.

    None decides by quantity: a displacement or velocity cannot follow a force at once, an
    acceleration does.
    """
    if feedthrough is None:
        return np.array([c.quantity not in ("displacement", "velocity") for c in channels])
    mask = np.asarray(feedthrough)
    if mask.dtype != np.bool_ or mask.shape not in ((), (len(channels),)):
        raise OptionError(
            f"feedthrough must be True, False, or {len(channels)} of these, one for each output; "
            f"got {feedthrough!r}."
        )
    return np.broadcast_to(mask, (len(channels),)).copy()
