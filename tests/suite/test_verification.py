"""Honest entries are verified; tampered ones are refused, naming the race and the step."""

import os
import random
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from stkzoo.cli import main
from stkzoo.errors import ConfigError, StkzooError
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.race.replay import load_replay, play_replay
from stkzoo.race.result import RaceResult
from stkzoo.race.settings import RaceSettings
from stkzoo.suite import TASKS, About, Entry, EntryRefused, evaluate, plan_entry, verify_entry
from stkzoo.suite.entry import ENTRY_FILE
from stkzoo.suite.verification import VerifyOrder, _compare
from tests.support.entries import (
    SAMPLER,
    SMALL,
    change_controls,
    change_header,
    change_replay,
    name_replays,
    read_entry,
    replay_of,
    write_entry,
)
from tests.support.remote_race import write_agent

ALONE, WITH_RIVAL, WITH_DRIVER, ALONE_IN_REVERSE = range(4)


#: The agent of the honest entry, in its folder.
AGENT = "agent.py"
SCRIPTED = About(agent_class="scripted")


@pytest.fixture(scope="module")
def honest(tmp_path_factory):
    """Creates an entry with six races of an agent from a file; returns its folder."""
    folder = tmp_path_factory.mktemp("entry") / "honest"
    folder.mkdir()
    (folder / AGENT).write_text(SAMPLER)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(TASKS, SMALL.name, SMALL)
        agent = f"{folder / AGENT}@:Ada"
        evaluate(SMALL, agent, output=folder, about=SCRIPTED, plot=False)
        yield folder


@pytest.fixture
def entry(honest, tmp_path):
    """Returns a copy of that folder."""
    return shutil.copytree(honest, tmp_path / "entry")


def refusal(folder, **options):
    with pytest.raises(EntryRefused) as caught:
        verify_entry(folder, jobs=1, **options)  # starts one program instead of one per core
    return str(caught.value)


def rename(folder, source, label, **about):
    """Gives the agent of an entry another source and name, in the card and in all replays."""
    card = read_entry(folder)
    (agent,) = card["plan"]["agents"]
    before = agent["label"]
    agent.update(source=source, label=label, files={})
    card["agent"] = label
    card["plan"]["about"].update(about)
    write_entry(folder, card)

    def change(header):
        for row in header["agents"]:
            row.update({"source": source, "name": label} if row["name"] == before else {})
        for row in header["result"]["agents"]:
            row.update({"source": source, "driver": label} if row["driver"] == before else {})

    for number in range(len(card["races"])):
        change_header(folder, number, change)
    name_replays(folder)


@pytest.mark.slow
def test_an_honest_entry_is_verified_without_stored_race_results(entry, capsys):
    shutil.rmtree(entry / "races")
    (entry / "plan.json").unlink()
    assert main(["suite", "verify", str(entry)]) == 0
    *_, verified, proof = capsys.readouterr().out.splitlines()
    assert verified == "Verified: 6 races as recorded, to the last bit."
    assert proof.startswith("Proven: the races took place. Not proven: that Ada drove; with")
    assert "`stkzoo suite verify ENTRY --agent AGENT` proves it." in proof


@pytest.mark.slow
def test_an_agent_that_samples_drives_its_entry_again(entry, tmp_path, capsys):
    assert main(["suite", "verify", str(entry), "--agent", str(entry / AGENT)]) == 0
    *_, proof = capsys.readouterr().out.splitlines()
    assert proof.startswith(f"Proven: {entry / AGENT} drove in all races. Not proven: what")
    other = tmp_path / "other.py"
    other.write_text(SAMPLER.replace("normal(0, 0.1)", "normal(0, 0.2)"))
    text = refusal(entry, agent=str(other))
    for number in range(6):
        assert re.search(rf"race {number} .*: step 1 has other controls of kart_\d than Ada", text)
    with pytest.raises(ConfigError, match=r"there is no agent 'nothing\.py'"):
        verify_entry(entry, agent="nothing.py")


@pytest.mark.slow
def test_the_entry_of_another_agent_is_not_that_of_a_driver_of_stkzoo(entry, capsys):
    """A name that is no driver of stkzoo is unproven; a driver of stkzoo drives again."""
    rename(entry, "runs/versus-ippo-0/agent", "ippo of stkzoo, seed 0", agent_class="learned")
    assert main(["suite", "verify", str(entry)]) == 0
    assert "Not proven: that ippo of stkzoo, seed 0 drove" in capsys.readouterr().out
    rename(entry, "runs/agent", "pretrained:zenith")
    with pytest.raises(ConfigError, match="is called 'pretrained:zenith', like a driver of stkzoo"):
        verify_entry(entry)
    rename(entry, "heuristic", "heuristic", agent_class="scripted")
    text = refusal(entry)
    assert re.search(r"race 0 \(lighthouse forward\): step 1 has other controls of kart_0", text)


@pytest.mark.slow
def test_changed_recordings_are_refused_at_their_step(entry):
    def control(step, kart, index):
        def change(controls):
            controls[step, kart, index] = 1 - controls[step, kart, index]
            return controls

        return change

    def brake(controls):
        controls[200, 0, :3] = 0, 0, 1
        return controls

    def change_digest(members):
        digests = bytearray(members["digests.u1"])
        digests[8 * 120] ^= 1
        members["digests.u1"] = bytes(digests)

    def finish_sooner(header):
        header["result"]["agents"][0]["finish_time"] -= 1

    assert plan_entry(SMALL, "random").orders()[WITH_DRIVER].drivers[0] == "heuristic"
    change_controls(entry, ALONE, brake)
    change_controls(entry, WITH_RIVAL, lambda controls: controls[:50])
    change_controls(entry, WITH_DRIVER, control(100, 0, 2))
    change_replay(entry, ALONE_IN_REVERSE, change_digest)
    change_header(entry, 4, finish_sooner)
    name_replays(entry)
    change_controls(entry, 5, control(100, 1, 4))
    text = refusal(entry)
    for problem in (
        r"race 0 \(lighthouse forward\): step 20[1-9] differs",
        r"race 1 \(lighthouse forward\): step 50: ",
        r"race 2 \(lighthouse forward\): step 101 has other controls of kart_0",
        r"race 3 \(lighthouse reversed\): step 120 differs",
        r"race 4 \(lighthouse reversed\): step \d+: .*finish_time",
        r"race 5 \(lighthouse reversed\): ",
    ):
        assert re.search(problem, text), text


@pytest.mark.slow
def test_a_race_with_changed_conditions_is_refused(entry):
    changed = {"seed": 1, "engine_seed": 1, "difficulty": 0, "track": "hacienda", "laps": 2}
    for number, condition in enumerate(changed.items()):
        change_header(entry, number, lambda header, pair=condition: header.update([pair]))
    name_replays(entry)
    head, *problems = refusal(entry).splitlines()
    assert head == f"the entry {entry} is refused:"
    assert len(problems) == len(changed)
    for number, problem in enumerate(problems):
        assert re.match(rf"race {number} \(lighthouse \w+\): .*step 0", problem)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda card: card["races"][ALONE]["karts"][0].update(time=9.0),
            r"race 0 \(lighthouse forward\), step \d+: karts\[0\].time is",
        ),
        (
            lambda card: card["races"][ALONE]["karts"][0].update(errors=3),
            r"karts\[0\].errors is 3, and the races give 0",
        ),
        (lambda card: card["score"].update(value=1.0), "entry.json: score.value is"),
        (lambda card: card.update(verified=None), "verified is not a field of an entry"),
    ],
)
def test_numbers_that_do_not_follow_from_the_races_are_refused(entry, change, message):
    card = read_entry(entry)
    change(card)
    write_entry(entry, card)
    claimed = Entry.load(entry / ENTRY_FILE)
    races = sorted((entry / "races").glob("*.json"))
    results = {number: RaceResult.load(file) for number, file in enumerate(races)}
    with pytest.raises(EntryRefused, match=message):
        _compare(claimed, entry, results)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda card: card["plan"].update(seeds=2), "seeds of the plan is not that of small"),
        (lambda card: card["plan"]["settings"].update(difficulty=1), "settings of the plan"),
        (lambda card: card["plan"].update(task_digest="0" * 64), "task_digest of the plan"),
        (lambda card: card["plan"]["population"].pop("ai:1"), "population of the plan"),
        (lambda card: card["plan"]["ai_times"]["lighthouse"].update(forward=99.0), "ai_times"),
        (lambda card: [card[name].pop() for name in ("races", "replays")], "it has 5 of 6 races"),
    ],
)
def test_changed_rules_are_refused_before_any_race(entry, change, message):
    card = read_entry(entry)
    change(card)
    write_entry(entry, card)
    assert message in refusal(entry)


@pytest.mark.slow
def test_missing_and_extra_replays_are_refused(entry):
    replay_of(entry, 3).rename(entry / "replays" / "extra.stkz")
    assert "one replay per race; see 00003.stkz, extra.stkz" in refusal(entry)


@pytest.mark.slow
def test_an_unknown_task_and_a_missing_entry_are_errors(entry, tmp_path):
    card = read_entry(entry)
    card["plan"]["task"] = "smal"
    write_entry(entry, card)
    with pytest.raises(ConfigError, match="unknown task 'smal'"):
        verify_entry(entry)
    with pytest.raises(ConfigError, match="has no suite entry"):
        verify_entry(tmp_path / "nothing")


def test_an_invalid_number_of_jobs_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="jobs is -1, expected a whole number of 1 or more"):
        verify_entry(tmp_path, jobs=-1)


@pytest.mark.slow
def test_other_names_in_the_replays_are_refused(entry):
    """Measures of conduct are by the names in the replays."""

    def rename(**changes):
        return lambda header: [agent.update(changes) for agent in header["agents"]]

    def change_result(**changes):
        return lambda header: header["result"]["agents"][0].update(changes)

    changed = [
        (rename(name="pretrained:apex"), "step 0: agents[0].name is 'pretrained:apex', and"),
        (rename(source="nothing"), "step 0: agents[0].source is 'nothing', and"),
        (
            lambda header: header["agents"][0].update(name="nobody"),  # the rival
            "step 0: agents[0].name is 'nobody', and the races give 'heuristic'",
        ),
        (change_result(driver="Eve"), "agents[0].driver is 'Eve', and"),
        (change_result(rescues=7), "agents[0].rescues is 7, and the races give 0"),
        (lambda header: header.update(kart_types=["gnu"] * 2), "step 0: kart_types[0] is 'gnu'"),
    ]
    for number, (change, _) in enumerate(changed):
        change_header(entry, number, change)
    name_replays(entry)
    text = refusal(entry)
    for number, (_, problem) in enumerate(changed):
        assert re.search(rf"race {number} .*: .*{re.escape(problem)}", text)


@pytest.mark.slow
@pytest.mark.parametrize("driver", ["ai", "random@:Rita", "heuristic"])
def test_an_entry_of_a_driver_of_stkzoo_is_verified_with_the_driver(
    driver, tmp_path, monkeypatch, capsys
):
    alone = replace(SMALL, forms=("P",), metric="time_ratio")
    monkeypatch.setitem(TASKS, SMALL.name, alone)
    written = evaluate(alone, driver, output=tmp_path, fresh="2026-12-01", plot=False)
    assert main(["suite", "verify", str(tmp_path)]) == 0
    *_, scores, _, proof = capsys.readouterr().out.splitlines()
    assert "(scripted) in small" in scores
    assert "2 of 2 races, fresh from '2026-12-01'" in scores
    assert proof.startswith(f"Proven: {driver.partition('@')[0]} drove in all races.")
    assert written.normalized_score is None
    card = read_entry(tmp_path)
    card["plan"]["fresh"] = "2026-12-02"
    write_entry(tmp_path, card)
    with pytest.raises(ConfigError, match=r"race 0 of the suite entry is .*, expected"):
        verify_entry(tmp_path)


@pytest.mark.slow
def test_an_entry_of_an_agent_that_fails_is_verified(tmp_path, monkeypatch):
    pair = replace(SMALL, forms=("PPB",))
    monkeypatch.setitem(TASKS, SMALL.name, pair)
    agent = write_agent(tmp_path, "bad", act="raise KeyError()")
    written = evaluate(pair, agent, output=tmp_path / "entry", about=SCRIPTED, plot=False)
    assert verify_entry(tmp_path / "entry").races == written.races
    assert verify_entry(tmp_path / "entry", agent=agent).races == written.races


@pytest.mark.slow
def test_facts_of_the_replays_that_no_score_depends_on_are_also_verified(entry):
    def change_row(agent, **changes):
        def change(header):
            (row,) = (row for row in header["result"]["agents"] if row["agent"] == agent)
            row.update(changes)

        return change

    def finish_sooner(header):
        header["result"]["agents"][0]["finish_time"] -= 0.005

    def steer(controls):
        controls[:, 1, 0] = 0.5
        return controls

    failure = {"step": 3, "kind": "error", "message": "x", "trace": ""}
    failed = change_row("kart_1", num_errors=1, errors=[failure])
    assert plan_entry(SMALL, "random").orders()[1].drivers[1] == "ai:3"
    change_controls(entry, 1, steer)
    for number, change in (
        (0, lambda header: header["result"].update(status="max_steps")),
        (2, finish_sooner),
        (3, lambda header: header["result"].update(race_time=1.0)),
        (4, failed),
        (5, lambda header: header["result"]["agents"].reverse()),
    ):
        change_header(entry, number, change)
    name_replays(entry)
    text = refusal(entry)
    for number, problem in enumerate(
        [
            r"step 3\d+: status is 'max_steps', expected 'finished'",
            "step 1 has other controls of kart_1",
            r"step 3\d+: agents\[0\].finish_time is",
            r"step 3\d+: race_time is 1.0",
            r"step 3\d+: agents\[1\].errors is",
            r"step 3\d+: agents\[0\].agent is 'kart_1'",
        ]
    ):
        assert re.search(rf"race {number} .*: {problem}", text), text


@pytest.mark.slow
def test_a_race_that_ends_early_or_for_another_reason_is_refused(entry):
    change_controls(entry, ALONE, lambda controls: controls[:20])
    change_header(entry, ALONE, lambda header: header.update(status="abandoned", result=None))
    shorter = play_replay(load_replay(replay_of(entry, ALONE))).result
    change_header(entry, ALONE, lambda header: header.update(result=shorter.to_dict()))

    def change(header):
        header["status"] = header["result"]["status"] = "awaited_finished"

    change_header(entry, ALONE_IN_REVERSE, change)
    name_replays(entry)
    text = refusal(entry)
    assert re.search("race 0 .*: step 20 does not end the race of kart_0", text)
    assert re.search("race 3 .*: status is 'awaited_finished', expected 'finished'", text)


def test_an_entry_cannot_loosen_the_limits_of_its_agent():
    default = RaceSettings()
    names = ("inline", "sandbox", "agent_memory", "action_timeout")
    loose = replace(default, inline=True, sandbox="off", agent_memory=None, action_timeout=None)
    order = VerifyOrder.of(RaceOrder(0, ("agent.py@:Ada",), loose, (0,)), "", "agent.py")
    assert [getattr(order.settings, n) for n in names] == [getattr(default, n) for n in names]


def test_a_strange_file_name_cannot_control_the_terminal(entry, capsys):
    (entry / "replays" / "\x1b]0;gone\x07").touch()
    assert main(["suite", "verify", str(entry)]) == 1
    shown = capsys.readouterr().err
    assert "?]0;gone?" in shown
    assert "\x1b" not in shown


# ---------------------------------------------------------------------- random changes

#: Entries of the card that nothing can verify (``docs/reference/suite.md``).
UNVERIFIED = re.compile(
    r"\.(about|versions|agent|errors|sandboxes|protections|type|schema_version)(\.|\[|$)"
    r"|^\.(agent|interval)|\.settings\.(?!track|laps|difficulty|reverse|mode|kart|seed|max_paths|"
    r"max_steps|max_steps_after_first|karts_finished)"
)
RACES = 6


def leaves(value, place=""):
    """Yields the container, key and path of each number, text and boolean in a JSON value."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in pairs:
        where = f"{place}.{key}" if isinstance(value, dict) else f"{place}[{key}]"
        if isinstance(inner, (dict, list)):
            yield from leaves(inner, where)
        else:
            yield value, key, where


def other_value(value, chance):
    """Returns another value of the same type."""
    if isinstance(value, bool) or value is None:
        return not value
    if isinstance(value, int):
        return value + chance.choice((-1, 1, 2))
    if isinstance(value, float):
        return value * chance.choice((0.9, 0.99, 0.999, 1.01)) if value else 0.5
    return chance.choice(("hacienda", "reversed", "front", "PBB", value + "x", ""))


def change_card(folder, chance):
    card = read_entry(folder)
    container, key, _ = chance.choice(
        [leaf for leaf in leaves(card) if not UNVERIFIED.search(leaf[2])]
    )
    container[key] = other_value(container[key], chance)
    write_entry(folder, card)


def change_position(folder, chance):
    """Changes the digest of the positions, rotations and velocities of one step."""
    share, bit = chance.random(), 1 << chance.randrange(8)

    def edit(members):
        digests = bytearray(members["digests.u1"])
        digests[int(share * len(digests))] ^= bit
        members["digests.u1"] = bytes(digests)

    change_replay(folder, chance.randrange(RACES), edit)
    name_replays(folder)


def change_steering(folder, chance):
    """Changes the steering of a kart in some steps of a race."""
    first, kart = chance.uniform(0.3, 0.8), chance.random()

    def edit(controls):
        start, row = int(first * len(controls)), int(kart * controls.shape[1])
        part = controls[start : start + 20, row, 1]
        part[:] = np.where(part > 0, part - 0.5, part + 0.5)
        return controls

    change_controls(folder, chance.randrange(RACES), edit)
    name_replays(folder)


@pytest.mark.matrix
@pytest.mark.parametrize("number", range(int(os.environ.get("STKZOO_ENTRIES", "20"))))
def test_a_random_change_of_an_entry_is_refused(entry, number):
    """To try more of them, set ``STKZOO_ENTRIES=1000``."""
    chance = random.Random(number)
    chance.choice((change_card, change_position, change_steering))(entry, chance)
    with pytest.raises(StkzooError):
        verify_entry(entry, jobs=1)
