"""Registration of the environments with Gymnasium."""

from importlib.util import find_spec


def register_environments() -> None:
    """Registers the environments if Gymnasium is installed."""
    if find_spec("gymnasium") is None:
        return
    from gymnasium.envs.registration import register, registry

    if "crumple/Platoon-v0" not in registry:
        register(
            id="crumple/Platoon-v0",
            entry_point="crumple.env:PlatoonEnv",
            vector_entry_point="crumple.env:PlatoonVectorEnv",
        )
