"""Networks of drivers, compared with the oracle."""

import copy
import itertools
import pickle

import numpy as np
import pytest

from stkzoo.agents.planning.network import Mlp
from tests.oracle import plan_network

SIZES = (50, 65, 16, 7)


def layers_of(seed, sizes=SIZES):
    chance = np.random.default_rng(seed)
    return tuple(
        (
            chance.normal(0, inputs**-0.5, (inputs, outputs)).astype(np.float32),
            chance.normal(0, 0.1, outputs).astype(np.float32),
        )
        for inputs, outputs in itertools.pairwise(sizes)
    )


def inputs_of(seed, count, width=SIZES[0] + 3):
    return np.random.default_rng(seed).normal(0, 2, (count, width)).astype(np.float32)


@pytest.mark.parametrize("is_tanh", [True, False])
@pytest.mark.parametrize("count", [0, 1, 3, 4, 9, 40])
def test_a_network_matches_the_oracle(is_tanh, count):
    layers, inputs = layers_of(count), inputs_of(count, count)
    ours = Mlp(layers, is_tanh)(inputs)
    theirs = plan_network.Mlp(layers, is_tanh)(inputs)
    np.testing.assert_allclose(ours, theirs, atol=1e-5)


@pytest.mark.parametrize("is_tanh", [True, False])
def test_a_row_does_not_depend_on_its_batch(is_tanh):
    network, inputs = Mlp(layers_of(3), is_tanh), inputs_of(4, 11)
    alone = [network(inputs[[row]]) for row in range(len(inputs))]
    np.testing.assert_array_equal(network(inputs), np.concatenate(alone))


@pytest.mark.parametrize("is_tanh", [True, False])
def test_nan_in_a_row_or_in_hidden_weights_reaches_the_outputs(is_tanh):
    layers, inputs = layers_of(7), inputs_of(8, 6)
    finite = Mlp(layers, is_tanh)(inputs)
    inputs[4, 0] = np.nan
    found = Mlp(layers, is_tanh)(inputs)
    assert np.isnan(found[4]).all()
    np.testing.assert_array_equal(np.delete(found, 4, axis=0), np.delete(finite, 4, axis=0))
    layers[1][0][3, 3] = np.nan
    assert np.isnan(Mlp(layers, is_tanh)(inputs)).all()


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda n: pickle.loads(pickle.dumps(n))])
def test_copies_and_pickles_have_the_same_outputs(duplicate):
    network, inputs = Mlp(layers_of(5), True), inputs_of(6, 3)
    np.testing.assert_array_equal(duplicate(network)(inputs), network(inputs))


def test_tanh_is_exact_to_a_few_bits_and_saturates():
    one, zero = np.ones((1, 1), np.float32), np.zeros(1, np.float32)
    numbers = np.concatenate([np.linspace(-30, 30, 100_001), [1e30, -1e30]])
    inputs = numbers.astype(np.float32)[:, None]
    found = Mlp(((one, zero), (one, zero)), True)(inputs)
    np.testing.assert_allclose(found, np.tanh(inputs.astype(np.float64)), atol=2e-7)
