"""Runners of the contenders: each imports, makes, resets and steps its environment.

Heavy imports happen on request, so that they can be timed.
"""

from __future__ import annotations

from typing import Any

#: Enough laps that no kart finishes during the measurement.
_LAPS = 20


class Runner:
    """Base class of the contenders' runners.

    Args:
        spec: fields of :class:`benchmarks.contenders.driver.Spec`.
    """

    def __init__(self, spec: dict[str, Any]) -> None:
        self.spec = spec

    def load(self) -> None:
        """Imports the measured library."""
        raise NotImplementedError

    def make(self) -> None:
        """Makes the environment."""

    def reset(self, track: str, seed: int, race: dict[str, Any] | None) -> None:
        """Starts a race; ``race`` is the result of :meth:`race` of another contender."""
        raise NotImplementedError

    def race(self) -> dict[str, Any]:
        """Returns the engine seed and the kart of each agent."""
        raise NotImplementedError

    def action(self, controls: Any) -> Any:
        """Converts controls to the argument of :meth:`step`; not measured."""
        raise NotImplementedError

    def step(self, action: Any) -> Any:
        """Makes a step; this is what is measured."""
        raise NotImplementedError

    def distances(self) -> list[float]:
        """Returns the overall distance of all karts; equal if all contenders ran the same race."""
        raise NotImplementedError

    def close(self) -> None:
        """Ends the race."""


class _Bare(Runner):
    """The engine without a library around it."""

    def load(self) -> None:
        import numpy  # noqa: F401 - otherwise the first race imports it
        import pystk2

        pystk2.init(pystk2.GraphicsConfig.none())
        self._pystk2 = pystk2
        self._race: Any = None

    def reset(self, track: str, seed: int, race: dict[str, Any] | None) -> None:
        pystk2, num_kart = self._pystk2, self.spec["num_kart"]
        race = race or {"seed": seed, "karts": list(range(self.spec["num_agents"]))}
        self.close()
        self._known = race
        kinds = pystk2.PlayerConfig.Controller
        config = pystk2.RaceConfig(
            num_kart=num_kart, seed=race["seed"], difficulty=2, track=track, laps=_LAPS
        )
        config.step_size = 0.1
        config.players.clear()
        for kart in range(num_kart):
            is_player = kart in race["karts"]
            kind = kinds.PLAYER_CONTROL if is_player else kinds.AI_CONTROL
            config.players.append(pystk2.PlayerConfig(controller=kind))
        self._race = pystk2.Race(config)
        self._race.start()
        self._world = pystk2.WorldState()
        while True:
            self._race.step()
            self._world.update()
            if self._world.phase == pystk2.WorldState.Phase.READY_PHASE:
                break

    def race(self) -> dict[str, Any]:
        return self._known

    def action(self, controls: Any) -> Any:
        from benchmarks.contenders.controls import to_action

        make = self._pystk2.Action
        rows = [to_action("full", controls[kart]) for kart in sorted(self._known["karts"])]
        return [
            make(
                acceleration=float(row["acceleration"][0]),
                steer=float(row["steer"][0]),
                **{key: bool(row[key]) for key in ("brake", "drift", "fire", "nitro", "rescue")},
            )
            for row in rows
        ]

    def step(self, action: Any) -> Any:
        return self._race.step(action)

    def distances(self) -> list[float]:
        self._world.update()
        return [float(kart.overall_distance) for kart in self._world.karts]

    def close(self) -> None:
        if self._race is not None:
            self._race.stop()
            self._race = self._world = None


class _Gym(Runner):
    """A Gymnasium id, of stkzoo or of the reference."""

    env: Any

    def _id(self) -> str:
        name = "multi-full" if self.spec["api"] == "multi" else self.spec["view"]
        return f"supertuxkart/{name}-v0"

    def _arguments(self, agent_spec: Any) -> dict[str, Any]:
        team = {}
        if self.spec["api"] == "multi":
            team["agents"] = [agent_spec() for _ in range(self.spec["num_agents"])]
        return {
            "num_kart": self.spec["num_kart"],
            "laps": _LAPS,
            "use_subprocess": self.spec["subprocess"],
            "max_episode_steps": 10**9,
            **team,
        }

    def _karts(self) -> list[int]:
        inner = self.env.unwrapped
        return list(inner.kart_indices) if self.spec["api"] == "multi" else [inner.kart_ix]

    def action(self, controls: Any) -> Any:
        from benchmarks.contenders.controls import to_action

        if self.spec["api"] == "multi":
            return {str(i): to_action("full", controls[k]) for i, k in enumerate(self._karts())}
        return to_action(self.spec["view"], controls[self._karts()[0]])

    def step(self, action: Any) -> Any:
        return self.env.step(action)

    def close(self) -> None:
        self.env.close()


class _StkzooGym(_Gym):
    def load(self) -> None:
        import stkzoo

        self._stkzoo = stkzoo

    def make(self) -> None:
        import gymnasium

        self.env = gymnasium.make(self._id(), **self._arguments(self._stkzoo.AgentSpec))

    def reset(self, track: str, seed: int, race: dict[str, Any] | None) -> None:  # noqa: ARG002
        self.last = self.env.reset(seed=seed, options={"track": track})

    @property
    def _core(self) -> Any:
        return self.env.unwrapped.core

    def race(self) -> dict[str, Any]:
        race = self._core.race
        return {"seed": race.seed, "karts": list(race.kart_indices)}

    def distances(self) -> list[float]:
        return [float(d) for d in self._core.snapshot.karts["overall_distance"]]


class _StkzooParallel(_StkzooGym):
    def make(self) -> None:
        view = self.spec["view"]
        if view == "control of full":
            from stkzoo.wrappers.control import ControlWrapper

            view = ControlWrapper
        self.env = self._stkzoo.RaceParallelEnv(
            agents=self.spec["num_agents"],
            num_kart=self.spec["num_kart"],
            view=view,
            laps=_LAPS,
            max_cycles=None,
            use_subprocess=self.spec["subprocess"],
            events=self.spec["events"],
        )

    @property
    def _core(self) -> Any:
        return self.env

    def action(self, controls: Any) -> Any:
        from benchmarks.contenders.controls import to_action

        karts = zip(self.env.agents, self.env.race.kart_indices, strict=True)
        return {agent: to_action(self.spec["view"], controls[kart]) for agent, kart in karts}


class _Reference(_Gym):
    """pystk2-gymnasium, patched to run a race that stkzoo has drawn."""

    def load(self) -> None:
        import pystk2_gymnasium

        self._reference = pystk2_gymnasium

    def make(self) -> None:
        import gymnasium
        from pystk2_gymnasium import envs

        self._imposed: dict[str, Any] | None = None
        original = envs.BaseSTKRaceEnv.warmup_race
        runner = self

        def warmup_race(env: Any) -> None:
            if runner._imposed is not None:
                runner._impose(env)
            original(env)

        envs.BaseSTKRaceEnv.warmup_race = warmup_race
        self.env = gymnasium.make(
            self._id(), track=None, **self._arguments(self._reference.AgentSpec)
        )

    def _impose(self, env: Any) -> None:
        import pystk2

        kinds, race = pystk2.PlayerConfig.Controller, self._imposed or {}
        env.config.seed = race["seed"]
        for kart in range(self.spec["num_kart"]):
            is_player = kart in race["karts"]
            kind = kinds.PLAYER_CONTROL if is_player else kinds.AI_CONTROL
            env.config.players[kart].controller = kind
        if self.spec["api"] == "multi":
            env.kart_indices = list(race["karts"])
            env.kart_m_indices = sorted(range(len(race["karts"])), key=race["karts"].__getitem__)
        else:
            (env.kart_ix,) = race["karts"]

    def reset(self, track: str, seed: int, race: dict[str, Any] | None) -> None:
        self.env.unwrapped.default_track = track
        self._imposed = race
        self.last = self.env.reset(seed=seed)

    def race(self) -> dict[str, Any]:
        return {"seed": self.env.unwrapped.config.seed, "karts": self._karts()}

    def distances(self) -> list[float]:
        return [float(kart.overall_distance) for kart in self.env.unwrapped.world.karts]


def runner_for(spec: dict[str, Any]) -> Runner:
    """Returns the runner for the fields of a :class:`benchmarks.contenders.driver.Spec`."""
    if spec["kind"] == "bare":
        return _Bare(spec)
    if spec["kind"] == "reference":
        return _Reference(spec)
    return _StkzooParallel(spec) if spec["api"] == "parallel" else _StkzooGym(spec)
