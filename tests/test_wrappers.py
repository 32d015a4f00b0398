from tests.generic_env import x
def test_a(): assert x
