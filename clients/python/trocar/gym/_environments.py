"""The Gymnasium environments: `NeedleEnv` and its vectorised counterpart."""
from __future__ import annotations

from os import PathLike
from typing import Any, Sequence

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from . import _picture
from ._episodes import ACTIONS, Episodes, limits
from ._task import read

Observation = npt.NDArray[np.float32]
Action = npt.NDArray[np.float32]


def _spaces(task: str) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    """Returns the observation space and the action space."""
    limit = limits(task)
    return gymnasium.spaces.Box(-limit, limit), gymnasium.spaces.Box(-1.0, 1.0, (len(ACTIONS[task]),))


def _checked(render_mode: str | None) -> str | None:
    if render_mode not in (None, "rgb_array"):
        raise ValueError(f"render_mode \"{render_mode}\": there is \"rgb_array\", or None")
    return render_mode


class NeedleEnv(gymnasium.Env[Observation, Action]):
    """An environment with one needle. task: one of TASKS; file: the task file, or None for the one that comes with the package.

    This class terminates episodes but never truncates them; the wrapper that `gymnasium.make` adds applies the time limit.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}

    def __init__(self, task: str = "reach", file: str | PathLike[str] | None = None, render_mode: str | None = None) -> None:
        self.render_mode = _checked(render_mode)
        self.task = read(task, file)
        self.metadata = {**self.metadata, "render_fps": round(1.0 / self.task.interval)}
        self.observation_space, self.action_space = _spaces(task)
        self._episodes = Episodes(self.task, 1, 1)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode with the tissue at rest and the needle in front of it. `options` is ignored."""
        super().reset(seed=seed)
        self._episodes.begin(np.ones(1, bool), [self.np_random])
        return self._episodes.observe()[0], _first(self._episodes.info())

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Applies an action for the task's `interval`."""
        result = self._episodes.step(np.asarray(action)[None], np.ones(1, bool))
        return self._episodes.observe()[0], float(result.reward[0]), bool(result.terminated[0]), False, _first(result.info)

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Returns an image (height, width, 3), or None if there is no render_mode."""
        return _picture.draw(self._episodes, 0) if self.render_mode else None


def _first(info: dict[str, npt.NDArray[Any]]) -> dict[str, Any]:
    return {key: value[0].item() for key, value in info.items()}


class VectorNeedleEnv(VectorEnv[Observation, Action, npt.NDArray[Any]]):
    """Many needles, each in its own tissue, stepped together by the threads of one `trocar.Batch`.

    After a reset with `seed`, row i goes through the same episodes as a single environment seeded with seed + i. threads: number of threads; 0 uses one
    per CPU available to the process. max_episode_steps: episodes are truncated after this many steps; None means never.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50, "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(self, num_envs: int = 1, task: str = "reach", file: str | PathLike[str] | None = None, render_mode: str | None = None,
                 max_episode_steps: int | None = None, threads: int = 0, autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP) -> None:
        self.num_envs, self.render_mode, self.max_episode_steps = num_envs, _checked(render_mode), max_episode_steps
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.task = read(task, file)
        self.metadata = {**self.metadata, "render_fps": round(1.0 / self.task.interval), "autoreset_mode": self.autoreset_mode}
        self.single_observation_space, self.single_action_space = _spaces(task)
        self.observation_space, self.action_space = batch_space(self.single_observation_space, num_envs), batch_space(self.single_action_space, num_envs)
        self._episodes = Episodes(self.task, num_envs, threads)
        self._randoms = [seeding.np_random()[0] for _ in range(num_envs)]
        self._steps = np.zeros(num_envs, int)
        self._ended = np.zeros(num_envs, bool)

    def reset(self, *, seed: int | Sequence[int | None] | None = None,
              options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode in each row. seed: a number s seeds row i with s + i, a sequence seeds it with its element i, and None lets each row's random
        generator continue. options["reset_mask"], (num_envs,) bool, selects the rows to reset; the others keep their observations."""
        mask = np.ones(self.num_envs, bool) if options is None or "reset_mask" not in options else np.asarray(options["reset_mask"])
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"reset_mask: write an array of {self.num_envs} booleans, at least one of them true")
        seeds: list[int | None] = [None] * self.num_envs
        if isinstance(seed, (int, np.integer)):
            seeds = [int(seed) + i for i in range(self.num_envs)]
        elif seed is not None:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"{len(seeds)} seeds: write one, or {self.num_envs}")
        for row in np.flatnonzero(mask):
            if seeds[row] is not None:
                self._randoms[row], _ = seeding.np_random(seeds[row])
        self._begin(mask)
        return self._episodes.observe(), _with_masks(self._episodes.info(), mask)

    def step(self, actions: Action) -> tuple[Observation, npt.NDArray[np.float64], npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Any]]:
        """Applies an action in each row for the task's `interval`. Where an episode has ended, a new one starts according to the autoreset mode."""
        again = self._ended if self.autoreset_mode == AutoresetMode.NEXT_STEP else np.zeros(self.num_envs, bool)
        if self.autoreset_mode == AutoresetMode.DISABLED and self._ended.any():
            raise gymnasium.error.ResetNeeded("rows %s have ended: call reset with options={\"reset_mask\": ...}" % np.flatnonzero(self._ended))
        result = self._episodes.step(actions, ~again)
        self._steps[~again] += 1
        terminated = result.terminated
        truncated = ~again & (self._steps >= self.max_episode_steps) if self.max_episode_steps else np.zeros(self.num_envs, bool)
        self._ended = terminated | truncated
        info: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and self._ended.any():
            again, last = self._ended.copy(), self._episodes.observe()
            info = {"final_obs": np.array([last[row] if again[row] else None for row in range(self.num_envs)], object), "_final_obs": again,
                    "final_info": _with_masks(result.info, again), "_final_info": again}
        ended = self._ended
        if again.any():
            self._begin(again)
        self._ended = ended if self.autoreset_mode != AutoresetMode.SAME_STEP else np.zeros(self.num_envs, bool)
        info.update(_with_masks(self._episodes.info(), np.ones(self.num_envs, bool)))
        return self._episodes.observe(), result.reward, terminated, truncated, info

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        """Returns an image (height, width, 3) of each row, or None if there is no render_mode."""
        return tuple(_picture.draw(self._episodes, row) for row in range(self.num_envs)) if self.render_mode else None

    def _begin(self, mask: npt.NDArray[np.bool_]) -> None:
        self._episodes.begin(mask, self._randoms)
        self._steps[mask] = 0
        self._ended = self._ended & ~mask


def _with_masks(info: dict[str, npt.NDArray[Any]], mask: npt.NDArray[np.bool_]) -> dict[str, Any]:
    """Adds to each key "k" a key "_k": the mask of the rows in which "k" is valid, by the convention of Gymnasium's vector environments."""
    return {**info, **{"_" + key: mask.copy() for key in info}}
