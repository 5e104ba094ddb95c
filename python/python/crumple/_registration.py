"""What Gymnasium knows of crumple."""

from importlib.util import find_spec


def register_environments() -> None:
    """Register the environments, where Gymnasium is installed."""
    if find_spec("gymnasium") is None:
        return
    from gymnasium.envs.registration import register, registry

    if "crumple/Platoon-v0" not in registry:
        register(
            id="crumple/Platoon-v0",
            entry_point="crumple.env:PlatoonEnv",
            vector_entry_point="crumple.env:PlatoonVectorEnv",
        )
