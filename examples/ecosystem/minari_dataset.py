"""Minari: races of the game's AI as an offline dataset of its observations and actions.

python examples/ecosystem/minari_dataset.py
"""

import os
import tempfile

import gymnasium as gym
import numpy as np

folder = tempfile.TemporaryDirectory()
os.environ["MINARI_DATASETS_PATH"] = folder.name

import minari

from stkzoo import AgentSpec
from stkzoo.wrappers import JoinedObservations


class Expert(gym.Wrapper):
    """Keeps the AI's choice and removes it from the observation."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        self.observation_space = env.observation_space["observation"]

    def reset(self, **options):
        observation, info = self.env.reset(**options)
        self.choice = observation["action"]
        return observation["observation"], info

    def step(self, action):
        observation, *rest = self.env.step(action)
        self.choice = observation["action"]
        return observation["observation"], *rest


def main() -> None:
    """Writes a dataset of two races, reads it and checks it."""
    env = gym.make(
        "supertuxkart/flattened_continuous_actions-v0",
        agent=AgentSpec(use_ai=True),
        num_kart=3,
        track="lighthouse",
        max_episode_steps=100,
    )
    recorder = minari.DataCollector(Expert(JoinedObservations(env)), record_infos=False)
    for seed in (1, 2):
        recorder.reset(seed=seed)
        done = False
        while not done:
            choice = recorder.env.choice  # the action of the AI, which drives
            *_, terminated, truncated, _ = recorder.step(choice)
            done = terminated or truncated
    dataset = recorder.create_dataset(
        dataset_id="supertuxkart/lighthouse/ai-v0",
        algorithm_name="the game's AI, difficulty 2",
        code_permalink="https://supertuxkart.net",
        author="stkzoo",
        description="What the game's AI saw and did in two races on lighthouse.",
        author_email="nobody@example.org",
    )
    episodes = list(minari.load_dataset("supertuxkart/lighthouse/ai-v0").iterate_episodes())
    print("episodes:", dataset.total_episodes, "steps:", dataset.total_steps)
    assert [len(episode.actions) for episode in episodes] == [100, 100]
    assert episodes[0].observations.shape == (101, 164)
    assert np.ptp(episodes[0].actions[:, 1]) > 0  # it steers
    recorder.close()


if __name__ == "__main__":
    main()
    folder.cleanup()
