"""A place in the search for oscillations: what the best amplitudes leave, and the slope.

Φ are the columns e^{−σt} cos, e^{−σt} sin, the sines of known frequency and a constant; D the
same times t. One triangular factor of [Φ D Y] gives amplitudes, errors and the Jacobian of
Kaufman (1975); normal equations of Φ would lose half the digits.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...linalg import solve_upper, triangle
from ...modes import Complexes
from ...record import Floats
from .components import Components, Signals, oscillations

ROUNDING = 1e-11  # of a channel's size: smaller errors cannot be told from rounding
SINGULAR = 1e-14  # of the scaled information: less is rounding


@dataclass(frozen=True, eq=False)
class Part:
    """The triangular factor of one record, in columns of unit length, and what it gives.

    Attributes
    ----------
    root : array (p, p)
        Upper triangular R with RᵀR = ΦᵀΦ (columns in their own units).
    amplitudes : array (p, n_channels)
        B of the columns of Φ.
    slopes : array (p, n_d)
        Φ⁺ D.
    inner : array (n_d, n_d)
        Triangular factor of what Φ leaves of D.
    across : array (n_d, n_channels)
        The errors in the coordinates of `inner`.
    squares : array (n_channels,)
        Σ e².
    """

    root: Floats
    amplitudes: Floats
    slopes: Floats
    inner: Floats
    across: Floats
    squares: Floats


@dataclass(frozen=True, eq=False)
class Place:
    """Components of some signals; the cost is −2 × log-likelihood, noise levels eliminated.

    Parameters follow `Components.moved`: all ω, all σ, then φ record by record, in units of
    1 / duration and radians.
    """

    components: Components
    signals: Signals

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        return tuple(self._part(record) for record in range(len(self.signals.samples)))

    @cached_property
    def variances(self) -> tuple[Floats, ...]:
        """Noise variance of each channel of each record, held off zero."""
        return tuple(
            part.squares / n + (ROUNDING * size) ** 2 + 1e-300
            for part, n, size in zip(
                self.parts, self.signals.lengths, self.signals.sizes, strict=True
            )
        )

    @cached_property
    def cost(self) -> float:
        pairs = zip(self.signals.lengths, self.variances, strict=True)
        return float(sum(n * np.log(v).sum() for n, v in pairs))

    @cached_property
    def gradient(self) -> Floats:
        """Half the slope of the cost."""
        total = np.zeros(self._size)
        for J, part, v in zip(self._jacobians, self.parts, self.variances, strict=True):
            total -= np.einsum("dkc,dc->k", J, part.across / v)
        return total

    @cached_property
    def information(self) -> Floats:
        """Fisher's, the amplitudes being unknown too; zero rows where nothing is searched."""
        total = np.zeros((self._size, self._size))
        for J, v in zip(self._jacobians, self.variances, strict=True):
            flat = (J / np.sqrt(v)).transpose(0, 2, 1).reshape(J.shape[0] * len(v), self._size)
            total += flat.T @ flat
        return total

    @cached_property
    def covariance(self) -> Floats:
        """Cramér-Rao bound of the parameters; zero of those that are not searched."""
        H = self.information
        size = np.sqrt(np.diag(H))
        size[size == 0] = np.inf
        inverse = np.linalg.pinv(H / size / size[:, None], rcond=SINGULAR, hermitian=True)
        return np.asarray(inverse / size / size[:, None])

    def noise(self, record: int) -> Floats:
        """Return the variance of the errors of each channel, amplitudes counted off."""
        n, p = self.signals.lengths[record], len(self.parts[record].root)
        return self.variances[record] * (n / (n - p))

    @property
    def neutral(self) -> Floats:
        return np.zeros((self._size, 0))

    def moved(self, step: Floats) -> Place:
        return Place(self.components.moved(step, self.signals), self.signals)

    def pushed_out(self, step: Floats) -> NDArray[np.bool_]:
        """Tell which decays are at a bound that the step would cross."""
        after = self.components.moved(step, self.signals)
        decays = self.components.unpacked(step)[1]
        stuck = (after.decays == self.components.decays) & (decays != 0) & self.components.damped
        out = np.zeros(self._size, dtype=bool)
        out[len(stuck) : 2 * len(stuck)] = stuck
        return out

    @property
    def relative_errors(self) -> float:
        """Root mean square of all errors over that of the data."""
        left = sum(float(part.squares.sum()) for part in self.parts)
        return float(np.sqrt(left / sum(float((y**2).sum()) for y in self.signals.samples)))

    def residual(self, record: int) -> Floats:
        """Return the errors (n_samples, n_channels) of one record."""
        table = self._columns(record)[0]
        return np.asarray(self.signals.samples[record] - table.T @ self.parts[record].amplitudes)

    def shapes(self, record: int) -> Complexes:
        """Return amplitudes c (n_channels, k) with y = Σ 2 Re(c e^{λt}) (φ turned in)."""
        a, b = self.pairs(record)
        turn = np.exp(1j * self.components.phases[record])
        return np.asarray(0.5 * ((a - 1j * b).T * turn))

    def pairs(self, record: int) -> tuple[Floats, Floats]:
        """Return the amplitudes of cos and sin (k, n_channels); sin of real ones is zero."""
        k, free = len(self.components), ~self.components.real
        B = self.parts[record].amplitudes
        b = np.zeros((k, B.shape[1]))
        b[free] = B[k : k + int(free.sum())]
        return B[:k], b

    @property
    def known_start(self) -> int:
        """Where the columns of known frequencies begin: cosines, then sines."""
        return len(self.components) + int((~self.components.real).sum())

    def constants(self, record: int) -> Floats:
        """Return the offset of each channel."""
        return np.asarray(self.parts[record].amplitudes[-1])

    def known_shapes(self, record: int) -> Complexes:
        """Return phasors (n_channels, n_known) with y = Σ Re(c e^{iωt})."""
        m, start = len(self.signals.known), self.known_start
        B = self.parts[record].amplitudes
        return np.asarray((B[start : start + m] - 1j * B[start + m : start + 2 * m]).T)

    # -- one record

    @property
    def _size(self) -> int:
        return len(self.components) * (2 + len(self.signals.samples))

    def _columns(self, record: int) -> tuple[Floats, Floats]:
        """Return the rows Φᵀ and Dᵀ."""
        c, signals = self.components, self.signals
        n = signals.lengths[record]
        z = oscillations(c, record, n, signals.dt)
        time = np.arange(n) * signals.dt
        angles = signals.known[:, None] * time
        Phi = np.vstack([z.real, z.imag[~c.real], np.cos(angles), np.sin(angles), np.ones((1, n))])
        later = z * (time / signals.duration)
        return Phi, np.vstack([z.imag[c.real], later.real, later.imag])

    def _part(self, record: int) -> Part:
        Phi, D = self._columns(record)
        p, d = len(Phi), len(D)
        size = np.linalg.norm(Phi, axis=1)
        table = np.vstack([Phi / size[:, None], D, self.signals.samples[record].T])
        R = triangle(table.T)
        answers = solve_upper(R[:p, :p], R[:p, p:]) / size[:, None]
        left = R[p:, p + d :]
        return Part(
            R[:p, :p] * size,
            answers[:, d:],
            answers[:, :d],
            R[p : p + d, p : p + d],
            left[:d],
            np.asarray((left**2).sum(axis=0)),
        )

    @cached_property
    def mixing(self) -> tuple[Floats, ...]:
        """What each parameter's derivative is of the columns of D (n_d, size, n_channels)."""
        return tuple(self._mixing(record) for record in range(len(self.signals.samples)))

    def _mixing(self, record: int) -> Floats:
        c = self.components
        k, r = len(c), int(c.real.sum())
        a, b = self.pairs(record)
        M = np.zeros((r + 2 * k, self._size, self.signals.n_channels))
        each = np.arange(k)
        M[r + each, each], M[r + k + each, each] = b, -a
        M[r + each, k + each] = -a * c.damped[:, None]
        M[r + k + each, k + each] = -b * c.damped[:, None]
        real = np.flatnonzero(c.real)
        M[np.arange(r), (2 + record) * k + real] = -a[real]
        return M

    @property
    def _jacobians(self) -> list[Floats]:
        return [
            np.tensordot(part.inner, M, axes=1)
            for part, M in zip(self.parts, self.mixing, strict=True)
        ]
