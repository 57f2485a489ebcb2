"""Functions of plug-ins that kernels call: compiled like kernels by another process, and cached by their contents."""

from __future__ import annotations

import base64
import pickle
import sys
from collections.abc import Sequence
from functools import cache

from rb_dynamics.loads.compiled_load import functions_in
from rb_dynamics.loads.plugin_load import SIGNATURE, PluginFunction
from rb_dynamics.motion.fixed_step_kernel import OnDemand
from rb_dynamics.numerics.compilation import compile_kernel, specialise
from rb_dynamics.numerics.object_code import Native


class PluginKernel(OnDemand):
    """A function of a plug-in; where it does not compile, its scenes run in plain Python, which is said once."""

    def __init__(self, function: PluginFunction) -> None:
        """Prepare, without compiling."""
        super().__init__(function.kind, specialise(function.template, function.name or "none"), SIGNATURE)
        self._plugin, self._fault, self._required = function, function.fault, False
        self._ahead = "a run with RB_DYNAMICS_COMPILE=always does it ahead"

    @property
    def refused(self) -> bool:
        """Whether it does not compile."""
        return bool(self._fault) or self._given_up

    @property
    def order(self) -> str | None:
        """The function for `kernel_of`: it is imported there, which is not possible for those of a script."""
        if getattr(self._plugin.part, "func", self).__module__ == "__main__":
            return None
        try:
            what = pickle.dumps((self._plugin.kind, self._plugin.template, self._plugin.part))
        except (pickle.PicklingError, AttributeError, TypeError):
            return None
        return base64.b64encode(pickle.dumps((sys.path, what))).decode()

    def _compile(self) -> Native:
        native = compile_kernel(self._function, self._signature, self._plugin.for_numba)
        self._plugin.enter(native)
        return native


@cache
def plugin_kernel(function: PluginFunction) -> PluginKernel:
    """Return the kernel of a function."""
    return PluginKernel(function)


def kernel_of(order: str) -> PluginKernel:
    """Return the kernel that another process has ordered."""
    path, what = pickle.loads(base64.b64decode(order))
    sys.path += [each for each in path if each not in sys.path]
    return PluginKernel(PluginFunction(*pickle.loads(what)))


def plugin_kernels(effects: tuple[float, ...]) -> tuple[PluginKernel, ...]:
    """Return the functions of plug-ins that kernels call for the numbers of effects."""
    return tuple(map(plugin_kernel, functions_in(effects)))


def are_ready(plugins: Sequence[PluginKernel], callers: Sequence[OnDemand], ahead: float, missed: float) -> bool:
    """Return whether the functions of plug-ins are there, and the kernels that call them; see `OnDemand.get`."""
    if not plugins:
        return True
    # Each is asked for, also if another is missing, but no kernel for functions that do not compile.
    found = [each.get(ahead, missed) for each in plugins]
    if any(each.refused for each in plugins):
        return False
    return None not in (*found, *(each.get(ahead, missed) for each in callers))
