"""The league: matchmaking, matches, the page, and resuming after a kill."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest

from stkzoo.agents.planning.driver import likeliest
from stkzoo.agents.pretrained.policy import RacingPolicy, network_shapes
from stkzoo.agents.pretrained.weights import save_weights
from stkzoo.agents.training.common.actors import SharedArray
from stkzoo.agents.training.common.matches import (
    AI,
    Finish,
    Match,
    MatchRecord,
    payoff,
    plan_match_driver,
    play_records,
    rate_orders,
)
from stkzoo.agents.training.export import export_policy
from stkzoo.agents.training.league.league import League, LeagueArguments, main
from stkzoo.agents.training.league.page import page
from stkzoo.agents.training.league.players import (
    LeagueMember,
    Player,
    PlayerMatchmaker,
    draw_matches,
    new_players,
)
from stkzoo.agents.training.ppo.network import PlanNetwork
from stkzoo.agents.training.ppo.opponents import DuelResults, Rival, RivalSeats, draw_opponent
from stkzoo.agents.training.ppo.rollouts import ActorArguments, RaceActor
from stkzoo.agents.training.ppo.selfplay import SelfPlayArguments, selfplay_setup
from stkzoo.cli import main as command_line
from stkzoo.errors import ConfigError
from tests.support.browser import Reader, open_browser
from tests.support.training import run_and_kill, words_of

SMALL = {
    "exploiters": 1,
    "league_exploiters": 0,
    "turn": 64,
    "matches": 1,
    "tracks": ("olivermath",),
    "races": ("2x1", "1+1x1"),
    "actors": 1,
    "n_steps": 16,
    "n_epochs": 1,
    "batch_size": 32,
    "warm_up": 1,
    "hidden": (16, 16),
}
MEMBERS = [
    LeagueMember("start", "", 0, 0, 0),
    LeagueMember("main-001", "main", 0, 10, 10),
    LeagueMember("exploiter-001", "exploiter", 0, 10, 20),
    LeagueMember("main-002", "main", 0, 20, 30),
]
MATCHES = [
    MatchRecord(1, "olivermath", False, ["main-001", "ai", "start"]),
    MatchRecord(2, "olivermath", False, ["exploiter-001", "main-001", "ai"]),
    MatchRecord(3, "olivermath", True, ["main-002", "main-001", "start", "exploiter-001", "ai"]),
]


def words(folder, until):
    return words_of(folder, SMALL, total_timesteps=until)


# ---------------------------------------------------------------------- players


def test_players_take_turns_in_order_of_their_kinds():
    names = [player.name for player in new_players(1, 2, 1)]
    assert names == ["main", "exploiter-a", "exploiter-b", "league-exploiter"]
    with pytest.raises(ConfigError, match="mains is 0, expected a whole number from 1 to 26"):
        LeagueArguments(mains=0)


def draws(kind, pool=(), count=300):
    matchmaker = PlayerMatchmaker(Player("me", kind), MEMBERS)
    matchmaker.restore(DuelResults(list(pool), []))
    random = np.random.default_rng(0)
    return [draw_opponent(matchmaker.odds(), random) for _ in range(count)]


def test_a_main_player_meets_itself_and_all_members():
    met = draws("main")
    assert 100 < met.count("") < 200
    assert set(met) == {"", *(member.name for member in MEMBERS)}


def test_an_exploiter_meets_the_newest_main_player():
    assert set(draws("exploiter")) == {"main-002"}
    hopeless = Rival("main-002", 0.05, 30)
    assert set(draws("exploiter", [hopeless])) == {"main-001", "main-002"}


def test_a_league_exploiter_meets_members_that_it_does_not_beat():
    pool = [Rival(member.name, 1.0, 30) for member in MEMBERS]
    pool[1].beaten = 0.1
    met = draws("league-exploiter", pool)
    assert met.count("main-001") > 200
    assert set(met) > {"main-001"}


def test_an_exploiter_that_won_or_trained_long_starts_over():
    exploiter = Player("exploiter", "exploiter", turns=1, kart_steps=50)
    assert not exploiter.is_done(0.5, patience=2)
    assert exploiter.is_done(0.9, patience=2)
    exploiter.turns = 2
    assert exploiter.is_done(0.5, patience=2)
    assert not Player("main", "main", turns=9).is_done(1.0, patience=2)
    exploiter.start_over()
    assert (exploiter.folder, exploiter.total_turns) == ("exploiter-g1", 2)
    assert exploiter.kart_steps == 0


# ---------------------------------------------------------------------- matches


def test_the_newest_member_meets_members_it_has_met_least():
    names = [member.name for member in MEMBERS]
    tracks = ["olivermath", "lighthouse"]
    random = np.random.default_rng(0)
    matches = draw_matches("main-002", [*names, "other"], MATCHES, tracks, 3, random)
    assert all(match.drivers[0] == "main-002" for match in matches)
    assert "other" in matches[0].drivers  # main-002 has met all others once
    assert [match.track for match in matches] == ["olivermath", "lighthouse", "olivermath"]
    assert [match.reverse for match in matches] == [False, False, True]
    alone = draw_matches("new", ["start", "new"], [], tracks, 1, random)
    assert alone[0].drivers == ("new", "start", "new", "new")


def test_payoffs_are_shares_of_common_matches():
    assert payoff("main-001", "start", MATCHES) == (1.0, 2)
    assert payoff("main-001", "exploiter-001", MATCHES) == (0.5, 2)
    assert payoff("main-002", "nobody", MATCHES) == (0.5, 0)


@pytest.mark.slow
def test_a_match_runs_to_its_end():
    """The two policies differ only in a bias toward braking."""
    plans = RacingPolicy.of_plans_alone()
    leaning = {**plans.weights, "b2": plans.weights["b2"].copy()}
    leaning["b2"][1] = 100.0
    policies = {"plans": plans, "brakes": RacingPolicy(leaning)}
    drivers = {name: plan_match_driver(policy) for name, policy in policies.items()}
    matches = draw_matches(
        "brakes", ["brakes", "plans"], [], ["olivermath"], 1, np.random.default_rng(0)
    )
    (match,) = play_records(matches, drivers, 3)
    assert sorted(match.order) == [AI, "brakes", "plans"]
    assert match.order.index("plans") < match.order.index("brakes")
    ratings = rate_orders([match.order])
    assert ratings["plans"].value > ratings["brakes"].value
    assert play_records(matches, drivers, 3) == [match]


def test_ranks_without_a_driver_belong_to_the_ai():
    match = Match(("a", "b", "a"), "lighthouse", bots=2)
    ends = [Finish(1.0, rank) for rank in (1, 3, 4)]
    assert match.order(ends) == ["a", "ai", "b"]


# ---------------------------------------------------------------------- learning


def driven_by_rivals(folder, races, odds):
    """Returns an actor after a rollout that trains which maneuver to begin, and the rollout."""
    setup = selfplay_setup(SelfPlayArguments(tracks=("olivermath",), races=races, num_starts=1))
    network = PlanNetwork([0], (8, 8), 0)
    arguments = ActorArguments(setup.groups, network.shape, setup.plans, folder, True)
    memory = SharedArray((2, 16, arguments.num_slots), network.shape.rollout_type())
    save_weights(folder / "start.safetensors", RacingPolicy.of_plans_alone().weights)
    actor = RaceActor(arguments, memory)
    try:
        actor.begin([0])
        actor.drive(0, *network.weights(), odds)
    finally:
        actor.close()
    return actor, memory.array()[0]


def test_rivals_sample_only_learned_choices_and_add_no_training_data(tmp_path):
    actor, rollout = driven_by_rivals(tmp_path, ("4x1", "1+1x1"), {"start": 1.0})
    race, alone = (part.seats for part in actor._parts)
    assert (race.names, alone.names) == (["start"], [""])
    assert (~race.is_own).sum() == 2
    is_rival = np.append(~race.is_own.reshape(-1), False)
    assert not rollout["active"][:, is_rival].any()
    assert not rollout["rewards"][:, is_rival].any()
    assert rollout["active"][:, ~is_rival].all()
    rivals = rollout[:, is_rival].reshape(-1)
    assert (rivals["choices"][:, 1:] == likeliest(rivals["prior"])[:, 1:]).all()


def test_a_duel_is_won_by_the_kart_ahead():
    seats = RivalSeats(1, 4)
    seats.seat(0, "start", np.random.default_rng(0))
    own = np.flatnonzero(seats.is_own[0]).tolist()
    positions = dict(zip([*own, *({0, 1, 2, 3} - {*own})], (1, 4, 2, 3), strict=True))
    over = [seats.end(slot, position) for slot, position in positions.items()]
    assert over == [False, False, False, True]
    assert seats.beaten(0) == 0.5


@pytest.mark.parametrize(
    ("races", "text"),
    [
        pytest.param(("1x4", "2+2x1"), "leave no kart to rivals", id="no duels"),
        pytest.param(("four",), "races 'four' are invalid", id="no races"),
    ],
)
def test_unusable_races_are_refused_before_anything_is_written(races, text, tmp_path, capsys):
    folder = tmp_path / "league"
    assert main(words_of(folder, SMALL | {"races": races}, total_timesteps=1)) == 1
    assert text in capsys.readouterr().err
    assert not folder.exists()


def test_resuming_with_other_arguments_is_refused(tmp_path):
    League(tmp_path, LeagueArguments(**SMALL))
    with pytest.raises(ConfigError, match="seed was 0, now 1"):
        League(tmp_path, LeagueArguments(**SMALL, seed=1))


@pytest.mark.slow
def test_an_exploiter_starts_over_after_the_initial_weights_were_deleted(tmp_path):
    init = tmp_path / "init.safetensors"
    shapes = network_shapes(SMALL["hidden"]).items()
    save_weights(init, {name: np.full(shape, 0.1, np.float32) for name, shape in shapes})
    league = League(tmp_path / "league", LeagueArguments(**SMALL, init=str(init)))
    init.unlink()
    league._state.players[1].start_over()
    league.play_turn(lambda *_: None)
    assert league.play_turn(lambda *_: None) == "exploiter-001"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a league that ran without interruption."""
    folder = tmp_path_factory.mktemp("league")
    assert main(words(folder, 100)) == 0
    return folder


@pytest.mark.slow
def test_members_of_a_league_take_turns_are_rated_and_become_agents(whole, tmp_path):
    state = json.loads((whole / "league.json").read_text())
    names = [member["name"] for member in state["members"]]
    assert names[:3] == ["start", "main-001", "exploiter-001"]
    assert set(state["ratings"]) >= {"start", "ai", "main-001"}
    assert "main-001" in (whole / "league.html").read_text()
    weights = whole / "members" / "main-001.safetensors"
    card = export_policy(weights, "learned", tmp_path / "learned") / "card.json"
    (run,) = json.loads(card.read_text())["runs"]
    assert run["kart_steps"] == state["members"][1]["kart_steps"]
    assert run["history"][-1]["arguments"]["tracks"] == state["arguments"]["tracks"]


@pytest.mark.matrix
@pytest.mark.skipif(os.name != "posix", reason="kills by signal")
def test_after_a_kill_the_turn_is_repeated_with_the_same_result(whole, tmp_path):
    run_and_kill(main, words(tmp_path, 100), tmp_path / "main-g0" / "log.jsonl", lines=1)
    assert main(words(tmp_path, 100)) == 0
    for name in ("league.json", "league.html"):
        assert (whole / name).read_bytes() == (tmp_path / name).read_bytes()


# ---------------------------------------------------------------------- the page

RATINGS = {name: [25.0 + n, 23.0, 29.0] for n, name in enumerate(["ai", "start", "main-001"])}
RATINGS |= {"main-002": [28.0, 26.0, 31.0], "exploiter-001": [24.0, 20.0, 27.0]}


def test_the_page_loads_no_external_files():
    text = page(MEMBERS, MATCHES, RATINGS)
    assert "http" not in text
    assert "<script" not in text
    odd = [replace(MEMBERS[1], name="<b>")]
    assert "<b>" not in page(
        odd, [MatchRecord(1, "olivermath", False, ["<b>", "ai"])], {"<b>": [1, 0, 2]}
    )


@pytest.mark.slow
def test_the_page_fits_phones_and_desktops(tmp_path):
    (tmp_path / "league.html").write_text(page(MEMBERS, MATCHES, RATINGS))
    browser = open_browser(tmp_path / "profile")
    try:
        reader = Reader(browser)
        for width, is_dark in ((390, False), (1280, True)):
            reader.show((tmp_path / "league.html").as_uri(), width=width, is_dark=is_dark)
            assert reader.text("h1") == "League"
            assert reader.run("return document.documentElement.scrollWidth") <= width
            assert len(reader.all("[id^=curve] use")) == 3  # past versions
            cells = [cell.text for cell in reader.all(".who td")]
            assert cells.count("100") >= 2
            paper = reader.run("return getComputedStyle(document.body).backgroundColor")
            assert paper == ("rgb(20, 25, 31)" if is_dark else "rgb(255, 255, 255)")
        assert reader.errors() == []
    finally:
        browser.quit()


def test_league_is_a_command_with_its_own_help(capsys):
    assert command_line(["league", "--help"]) == 0
    assert "stkzoo league --output leagues/first" in capsys.readouterr().out
    assert command_line(["league"]) == 2
    assert "--output" in capsys.readouterr().err
