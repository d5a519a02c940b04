"""Gymnasium environments in which a controller drives a needle through tissue.

    >>> import gymnasium, trocar.gym
    >>> env = gymnasium.make("trocar/Reach-v0")
    >>> observation, info = env.reset(seed=1)
    >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())

The environments are trocar/Reach-v0, trocar/Avoid-v0 and trocar/Implant-v0; docs/learning.md describes their spaces, rewards and files.
`gymnasium.make_vec` makes a vector environment whose rows run in parallel in one `trocar.Batch`.
"""
from __future__ import annotations

try:
    import gymnasium
except ImportError as missing:
    raise ImportError("trocar.gym needs the package gymnasium, 1.0 or newer: run `pip install gymnasium`, on Debian in an environment made by "
                      "`python3 -m venv --system-site-packages`") from missing

from ._environments import NeedleEnv, VectorNeedleEnv
from ._task import TASKS, BadTask, Task, read

__all__ = ["TASKS", "BadTask", "NeedleEnv", "Task", "VectorNeedleEnv", "read"]

MAX_EPISODE_STEPS = 150

for _name in TASKS:
    _id = f"trocar/{_name.capitalize()}-v0"
    if _id not in gymnasium.registry:
        gymnasium.register(_id, entry_point="trocar.gym:NeedleEnv", vector_entry_point="trocar.gym:VectorNeedleEnv", max_episode_steps=MAX_EPISODE_STEPS,
                           kwargs={"task": _name})
