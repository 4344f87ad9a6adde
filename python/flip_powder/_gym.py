"""The name of the environments in Gymnasium; loaded by Gymnasium itself, so it imports nothing that is not needed."""

from gymnasium.envs.registration import register as _register
from gymnasium.envs.registration import registry

#: The name under which both environments are registered.
ENV_ID = "FlipWeigh-v0"


def register() -> None:
    """Registers both environments, once."""
    if ENV_ID not in registry:
        _register(
            ENV_ID,
            entry_point="flip_powder.env:FlipWeighEnv",
            vector_entry_point="flip_powder.env:FlipWeighVectorEnv",
        )
