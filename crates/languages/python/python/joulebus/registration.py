"""The names of this package's environments in gymnasium: what its entry point, and `import joulebus`, call."""
from __future__ import annotations

from ._optional import needed

#: One robot. ``robots=3`` is an arena of three.
ENERGY = "joulebus/Energy-v0"


def register() -> None:
    """Registers the environments, unless they are registered."""
    gymnasium = needed("gymnasium", "environments")
    if ENERGY not in gymnasium.registry:
        gymnasium.register(
            id=ENERGY,
            entry_point="joulebus.vector_env:EnergyEnv",
            vector_entry_point="joulebus.vector_env:EnergyVectorEnv",
            kwargs={"robots": None},
        )
