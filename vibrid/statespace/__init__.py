"""StateSpace, and the fast simulation under it."""

from .checks import as_inputs, as_state
from .lifting import Lifting, block_states, free_responses, simulate, simulate_states
from .response import sampled_response
from .sampling import HOLDS, state_shift
from .state_space import StateSpace

__all__ = [
    "HOLDS",
    "Lifting",
    "StateSpace",
    "as_inputs",
    "as_state",
    "block_states",
    "free_responses",
    "sampled_response",
    "simulate",
    "simulate_states",
    "state_shift",
]
