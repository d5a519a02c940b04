"""A stand-in for the gymnasium package with the few names that trocar.gym uses, for tests on machines where the package cannot be installed. Seeds and spaces
behave as in Gymnasium 1.x; nothing else is implemented."""
import enum
import sys
import types

import numpy as np


class Box:
    def __init__(self, low, high, shape=None, dtype=np.float32):
        shape = np.shape(low) if shape is None else shape
        self.low, self.high, self.shape, self.dtype = np.full(shape, low, dtype), np.full(shape, high, dtype), shape, dtype

    def __contains__(self, x):
        return x.shape == self.shape and x.dtype == self.dtype and bool(np.all(x >= self.low) and np.all(x <= self.high))


class Env:
    metadata, render_mode, np_random = {}, None, None

    def __class_getitem__(cls, _):
        return cls

    def reset(self, *, seed=None, options=None):
        if seed is not None or self.np_random is None:
            self.np_random = np.random.default_rng(seed)


class AutoresetMode(enum.Enum):
    NEXT_STEP, SAME_STEP, DISABLED = "NextStep", "SameStep", "Disabled"


class VectorEnv(Env):
    pass


def install():
    """Makes `import gymnasium` return this stand-in."""
    modules = {name: types.ModuleType(name) for name in ("gymnasium", *("gymnasium." + part for part in ("spaces", "error", "utils", "utils.seeding", "vector",
                                                                                                        "vector.utils")))}
    sys.modules.update(modules)
    for name, module in modules.items():
        parent, _, own = name.rpartition(".")
        if parent:
            setattr(modules[parent], own, module)
    root = modules["gymnasium"]
    root.Env, root.registry, root.register = Env, {}, lambda id, **spec: root.registry.__setitem__(id, spec)
    root.spaces.Box = Box
    root.error.ResetNeeded = type("ResetNeeded", (Exception,), {})
    root.utils.seeding.np_random = lambda seed=None: (np.random.default_rng(seed), seed)
    root.vector.AutoresetMode, root.vector.VectorEnv = AutoresetMode, VectorEnv
    root.vector.utils.batch_space = lambda space, n: Box(np.repeat(space.low[None], n, axis=0), np.repeat(space.high[None], n, axis=0))
