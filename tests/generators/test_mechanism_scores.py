"""How the diagnosis of a mechanism is judged against what was hidden in it."""

from experiments.mechanism_scores import judge

TRUTH = {
    "kind": "single",
    "seed": 1,
    "machine": "furuta",
    "mode": "position",
    "joints": ["arm", "free"],
    "effects": [
        {
            "name": "sensor_lag",
            "joints": ["arm", "free"],
            "outside": False,
            "share": {},
            "accept": [{"name": "sensor_lag", "joints": ["arm"]}],
            "also_right": [{"name": "sensor_lag", "joints": ["arm", "free"]}],
        }
    ],
}


def judged(*alternatives):
    named = {"name": "delay", "joints": ["arm"], "alternatives": list(alternatives)}
    row = judge(TRUTH, {"verdict": "explained_class", "effects": [named]})
    return row["outcome"], row["wrong"]


def test_an_alternative_at_all_joints_is_one_at_each():
    assert judged("sensor_lag@all joints") == ("right", 0)
    assert judged("sensor_lag@arm") == ("right", 0)
    assert judged("sensor_lag@free") == ("partly", 0)  # where it need not be told
    assert judged("actuator_lag@all joints") == ("wrong", 1)
