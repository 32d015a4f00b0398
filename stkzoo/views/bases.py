"""The base classes of wrappers that the machinery of views knows."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any, SupportsFloat

import gymnasium as gym

if TYPE_CHECKING:
    from typing_extensions import Self

    from stkzoo.views.plan import ViewPlan


class ActionObservationWrapper(gym.Wrapper[Any, Any, Any, Any]):
    """Changes the actions on their way in and the observations on their way out.

    Subclasses define :meth:`action` and :meth:`observation`, and set ``action_space``
    and ``observation_space`` where these differ from the wrapped environment's.
    """

    def action(self, action: Any) -> Any:
        """The wrapped environment's form of an action of this wrapper."""
        raise NotImplementedError

    def observation(self, observation: Any) -> Any:
        """This wrapper's form of an observation of the wrapped environment."""
        raise NotImplementedError

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Resets the wrapped environment and changes the observation."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self.observation(observation), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Steps the wrapped environment with the changed action."""
        observation, reward, terminated, truncated, info = self.env.step(self.action(action))
        return self.observation(observation), reward, terminated, truncated, info


class RecordedWrapper(gym.utils.RecordConstructorArgs):
    """Records the arguments of the constructor, so that a wrapper can be made again from ``spec``.

    Subclasses need not do anything for it.
    """

    def __new__(cls, *arguments: Any, **keywords: Any) -> Self:
        """The wrapper, with all arguments but the environment recorded."""
        made = super().__new__(cls)
        _, env, *names = inspect.signature(cls.__init__).parameters
        recorded = {**dict(zip(names, arguments[1:], strict=False)), **keywords}
        recorded.pop(env, None)
        gym.utils.RecordConstructorArgs.__init__(made, _disable_deepcopy=True, **recorded)
        return made


class CompiledWrapper(RecordedWrapper):
    """Marks a wrapper that says how the kernel does its work.

    A wrapper class that lists this class among its direct bases promises that

    - ``observation`` and ``action`` depend on nothing but their input and the
      constructor's arguments, and change neither; or else ``has_memory`` is true;
    - :meth:`compile_into` says what they do;
    - ``reset`` and ``step`` are Gymnasium's own, and rewards are left alone.

    The promise is not inherited, because a subclass may break it: a subclass that keeps
    it lists this class again.

    Attributes:
        has_memory: whether the wrapper remembers something from step to step.
    """

    has_memory = False

    def compile_into(self, plan: ViewPlan) -> bool:
        """Adds what this wrapper does to the plan of an agent's view.

        Args:
            plan: what the wrappers inside this one do.

        Returns:
            Whether the plan can say it. If not, the plan is as it was, and this wrapper and
            all outside of it run as they are.
        """
        raise NotImplementedError

    def keeps_promise(self) -> bool:
        """Whether the object's own class lists :class:`CompiledWrapper`."""
        return CompiledWrapper in type(self).__bases__
