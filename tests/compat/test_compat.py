"""Code for pystk2-gymnasium runs on stkzoo. Each case runs in its own interpreter."""

import importlib.util
import subprocess
import sys
import textwrap

import pytest

from tests.support import paths
from tests.support.programs import ProgramRunner

pytestmark = pytest.mark.slow

TAKE_OVER = "import stkzoo.compat\n"

PRELUDE = """
import warnings
import gymnasium as gym
import numpy as np
import pystk2_gymnasium

def action(throttle=1.0):
    return dict(acceleration=np.array([throttle], np.float32), steer=np.array([0.0], np.float32),
                brake=0, drift=0, fire=0, nitro=0, rescue=0)
"""


def run_python(code):
    """Runs code in a fresh interpreter with warnings as errors; returns its output."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.fixture(scope="module")
def runner():
    with ProgramRunner(TAKE_OVER + PRELUDE, "-W", "error") as runner:
        yield runner


@pytest.fixture
def on_stkzoo(runner):
    """Returns a function that runs a case after the common imports and returns its output."""

    def run(code):
        done = runner.run(textwrap.dedent(code))
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    return run


def on_reference(code):
    return run_python(textwrap.dedent(code))


OWNERS = """
import gymnasium, importlib, pystk2_gymnasium, pystk2_gymnasium.envs, sys
names = {module.__name__.split(".")[0] for name, module in list(sys.modules.items())
         if name.split(".")[0] == "pystk2_gymnasium"}
ids = {str(spec.entry_point).split(".")[0] for name, spec in gymnasium.registry.items()
       if name.startswith("supertuxkart/")}
classes = pystk2_gymnasium.envs.STKRaceEnv, pystk2_gymnasium.AgentSpec
print(*names, *ids, *(kind.__module__ for kind in classes))
"""
COMPLETE = "stkzoo stkzoo stkzoo.env.gymnasium_api stkzoo.config"


@pytest.mark.parametrize("again", ["", "stkzoo.compat.install()"])
def test_an_installed_reference_is_replaced(again):
    assert importlib.util.find_spec("pystk2_gymnasium") is not None
    assert run_python(f"import stkzoo.compat\n{again}\n{OWNERS}") == COMPLETE


@pytest.mark.parametrize(
    "before",
    [
        "import pystk2_gymnasium\nimport stkzoo.compat",
        # both packages register the ids, so Gymnasium warns when the reference is imported
        "import stkzoo, pystk2_gymnasium.pystk_process\nimport stkzoo.compat",
    ],
)
def test_a_reference_imported_before_is_replaced_with_one_warning(before):
    code = f"""
import warnings
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
{textwrap.indent(before, "    ")}
texts = [str(warning.message) for warning in caught]
print(*(text for text in texts if "Overriding environment" not in text))
"""
    said, owners = run_python(code + OWNERS).splitlines()
    assert owners == COMPLETE
    assert said.count("was imported before stkzoo.compat") == 1
    assert "`import stkzoo.compat` above the first import of pystk2_gymnasium" in said


def test_loading_an_agent_does_not_replace_the_reference():
    place = str(paths.AGENTS / "reference")
    code = f"""
import sys, warnings
import pystk2_gymnasium
warnings.simplefilter("ignore")
from stkzoo.drivers.code import load_agent
from stkzoo.drivers.files import AgentPlace
load_agent(AgentPlace(("pystk_actor",), first={place!r}))
print(pystk2_gymnasium.envs.STKRaceEnv.__module__, sys.modules["pystk2_gymnasium"].__name__)
"""
    assert run_python(code) == "pystk2_gymnasium.envs pystk2_gymnasium"


def test_a_missing_reference_is_replaced_by_importing_compat():
    code = """
    import sys

    class WithoutReference:
        def __init__(self, finder):
            self.finder = finder

        def find_spec(self, name, path=None, target=None):
            if name.partition(".")[0] != "pystk2_gymnasium":
                return self.finder.find_spec(name, path, target)

    sys.meta_path[:] = map(WithoutReference, sys.meta_path)
    import stkzoo.compat
    from pystk2_gymnasium.envs import STKRaceEnv
    print(STKRaceEnv.__module__)
    """
    assert on_reference(code) == "stkzoo.env.gymnasium_api"


def test_the_race_can_be_read_from_the_unwrapped_environment(on_stkzoo):
    code = """
    env = gym.make("supertuxkart/multi-full-v0", agents=[pystk2_gymnasium.AgentSpec()] ,
                   num_kart=3, track="lighthouse")
    env.reset(seed=1)
    base = env.unwrapped
    print(base.default_track, base.current_track, base.num_kart)
    print(len(base.track.successors) == len(base.track.path_nodes), base.track.length > 100)
    before = [np.array(kart.location) for kart in base.world.karts]
    for _ in range(60):
        env.step({"0": action()})
    kart = base.world.karts[base.kart_indices[0]]
    print(np.linalg.norm(kart.location - before[kart.id]) > 5)
    print(kart.has_finished_race, kart.position in (1, 2, 3), kart.finished_laps, kart.node >= 0)
    print(kart.powerup.num, kart.attachment.type.name, len(base.world_update().items) > 0)
    env.close()
    """
    assert on_stkzoo(code).splitlines() == [
        "lighthouse lighthouse 3",
        "True True",
        "True",
        "False True 0 True",
        "0 NOTHING True",
    ]


def test_each_agent_can_have_its_own_wrappers(on_stkzoo):
    code = """
    from pystk2_gymnasium import AgentSpec, MonoAgentWrapperAdapter
    from pystk2_gymnasium.stk_wrappers import ConstantSizedObservations, DiscreteActionsWrapper
    from pystk2_gymnasium.wrappers import FlattenerWrapper, FlattenMultiDiscreteActions

    def wrap(env):
        env = ConstantSizedObservations(env, state_items=3, state_paths=10, add_mask=True)
        env = DiscreteActionsWrapper(env, acceleration_steps=3, steer_steps=9)
        return FlattenMultiDiscreteActions(FlattenerWrapper(env))

    env = MonoAgentWrapperAdapter(
        gym.make("supertuxkart/multi-full-v0", agents=[AgentSpec(), AgentSpec()], num_kart=3,
                 track="lighthouse"),
        keep_original=True,
        wrapper_factories={"0": wrap, "1": lambda env: env},
    )
    observations, _ = env.reset(seed=1)
    for _ in range(10):
        actions = {key: env.action_space[key].sample() for key in "01"}
        observations, *_ = env.step(actions)
    print(sorted(observations), env.observation_space.contains(observations))
    print(type(observations["0"]).__name__, type(actions["0"]).__name__)
    env.close()
    """
    assert on_stkzoo(code).splitlines() == [
        "['0', '1', 'original/0', 'original/1'] True",
        "dict int64",
    ]


def test_any_numbers_and_keys_are_read_as_in_the_reference_and_logged_once_per_race(on_stkzoo):
    code = """
    import logging, sys
    from pystk2_gymnasium import AgentSpec, MonoAgentWrapperAdapter
    from pystk2_gymnasium.stk_wrappers import DiscreteActionsWrapper
    from stkzoo import ActionError

    def controls(env, action):
        race = env.unwrapped.live_race
        return race.convert(race.check(action))[0].tolist()

    logging.basicConfig(stream=sys.stdout, format="logged %(levelname)s")
    race = dict(num_kart=1, track="lighthouse")
    env = gym.make("supertuxkart/full-v0", **race)
    for seed in range(2):
        env.reset(seed=seed)
        odd = action(2.0) | {"brake": np.array([0.63]), "drift": -1.0, "fire": 2, "nitro": 1.9,
                             "rescue": True, "jump": 1, 7: 0, "steer": [5]}
        print(controls(env, {"kart_0": odd}))
        for _ in range(2):
            env.step(odd)
    for bad in (float("nan"), float("inf"), None, "x", [0, 1]):
        try:
            env.step(action() | {"brake": bad})
        except ActionError:
            print("refused")
    env.close()

    env = gym.make("supertuxkart/flattened-v0", **race)
    env.reset(seed=1)
    numbers = {"continuous": np.array([1.5, -3.0]), "discrete": [0.6, 1.2, -1, 2, 0]}
    print(controls(env, {"kart_0": numbers}))
    env.close()

    env = gym.make("supertuxkart/multi-full-v0", agents=[AgentSpec()], **race)
    env = MonoAgentWrapperAdapter(env, wrapper_factories={"0": DiscreteActionsWrapper})
    env.reset(seed=1)
    env.step({"0": {**env.action_space["0"].sample(), "brake": 0.9, "acceleration": 7.5, "k": 1}})
    env.close()
    """
    assert on_stkzoo(code).splitlines() == [
        *["logged WARNING", "[1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0]"] * 2,
        *["refused"] * 5,
        "logged WARNING",
        "[1.0, -1.0, 0.0, 1.0, 0.0, 1.0, 0.0]",
        "logged WARNING",
    ]


def test_the_world_has_what_adapters_of_the_reference_read(on_stkzoo):
    code = """
    import pystk2
    from pystk2_gymnasium.envs import Phase

    agent = pystk2_gymnasium.AgentSpec(kart="sara_the_racer")
    env = gym.make("supertuxkart/simple-v0", agent=agent, num_kart=2, track="lighthouse")
    env.reset(seed=1)
    base = env.unwrapped
    kart, other = base.world.karts[base.kart_ix], base.world.karts[1 - base.kart_ix]
    print(kart.name, other.name, kart.player_id == kart.id, kart.lives)
    print([player.kart.id for player in base.world.players], base.world.players[0].camera)
    item = base.world.items[0]
    print(item.type == pystk2.Item.Type(item.type.value), item.type == item.Type[item.type.name])
    print(Phase.from_stk(base.world.phase).name, Phase.from_stk(None).name,
          Phase.from_stk(pystk2.WorldState.Phase.FINISH_PHASE).name)
    config = base.config
    print(config.num_kart, config.track, config.laps, config.players[base.kart_ix].kart)
    seen = base.get_observation(base.kart_ix, False), base.get_observation(1 - base.kart_ix, True)
    print(seen[0]["kart_type"], seen[1]["kart_type"], sorted(seen[1]["action"])[0])
    full = gym.make("supertuxkart/full-v0", num_kart=2, track="lighthouse")
    observation, _ = full.reset(seed=1)
    print(str(full.unwrapped.get_observation(full.unwrapped.kart_ix, False)) == str(observation))
    full.close()
    env.close()
    """
    assert on_stkzoo(code).splitlines() == [
        "Pepper Tux True 0",
        "[0, 1] None",
        "True True",
        "READY_PHASE READY_PHASE RACE_PHASE",
        "2 lighthouse 1 sara_the_racer",
        "sara_the_racer tux acceleration",
        "True",
    ]


UTILITIES = """
from enum import Enum
import numpy as np
import pystk2
from gymnasium import spaces
from pystk2_gymnasium.envs import Phase
from pystk2_gymnasium.utils import Discretizer, max_enum_value, rotate, rotate_batch

random = np.random.default_rng(0)
for kind in (np.float32, np.float64):
    q = random.normal(size=4).astype(kind)
    q /= np.linalg.norm(q)
    vectors = random.normal(size=(5, 3)).astype(kind)
    turned = [rotate(vectors[0], q), *rotate_batch(vectors, q)]
    print(*(row.dtype for row in turned))
    print(*(f"{number:.4f}" for row in turned for number in row))

class Own(Enum):
    ONE = 1
    SEVEN = 7

print(*map(max_enum_value, (pystk2.Powerup, pystk2.Attachment, pystk2.Item, Phase, Own)))
for low, count in ((-1, 7), (0, 5)):
    steps = Discretizer(spaces.Box(low, 1, (1,)), count)
    print(steps.space, steps.values, steps.min_value, steps.max_value)
    print(*(f"{steps.continuous(k):.6f}" for k in range(count)))
"""


def test_utilities_match_the_reference(on_stkzoo):
    assert on_stkzoo(UTILITIES) == on_reference(UTILITIES)
