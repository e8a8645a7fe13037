"""Pages that are read once: the example has the numbers of its run, the blocks of pages by robot
and of SKILL.md run with small stand-ins for the robots, and pages stay short.
"""

import json
import re
import runpy
import shutil
from pathlib import Path

import mujoco
import pytest

from adaptsim_jax.diagnosis.rules import RULES

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
HOOKS = runpy.run_path(str(DOCS / "hooks.py"))
RUN = runpy.run_path(str(DOCS / "run_blocks.py"))
JUDGED = json.loads((DOCS / "images" / "judged.json").read_text())
BY_ROBOT = ("so101", "arm", "unitree", "bench")
NOT_RUN = re.compile(r"^```\{\.(?:bash|python) title=\"needs the (?:\w+)\"\}$", re.M)

LINK = """<body pos="0 0 {z}"><joint name="{a}" axis="0 1 0" range="-1.5 1.5" damping="0.2"/>
<inertial pos="0 0 -0.1" mass="0.4" diaginertia="0.002 0.002 0.0002"/>{more}</body>"""
ROBOT = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
<worldbody>{base}</worldbody><actuator>{actuators}</actuator></mujoco>"""
SERVO = '<position name="{n}" joint="{n}" kp="20" kv="0.5" ctrlrange="-1 1" forcerange="-8 8"/>'
MOTOR = '<motor name="{n}" joint="{n}" ctrlrange="-2 2"/>'


def stand_in(joints: list[str], actuator: str, free: bool = False) -> str:
    """A chain of links with a robot's names for its joints."""
    chain = ""
    for k, name in reversed(list(enumerate(joints))):
        chain = LINK.format(z=-0.2 if k else 0.0, a=name, more=chain)
    if free:
        root = '<freejoint name="root"/><geom type="box" size="0.1 0.1 0.05" mass="4"/>'
        chain = f'<body name="trunk" pos="0 0 1">{root}{chain}</body>'
    return ROBOT.format(base=chain, actuators="".join(actuator.format(n=n) for n in joints))


STAND_INS = {
    "so101.xml": stand_in(["shoulder_lift", "elbow_flex", "gripper"], SERVO),
    "arm.xml": stand_in(["joint1", "joint2"], SERVO),
    "go2.xml": stand_in(["FL_thigh_joint", "FL_calf_joint"], MOTOR, free=True),
}


def page_of(name: str) -> Path:
    return DOCS / "howto" / f"{name}.md"


def test_the_example_has_the_numbers_of_its_run():
    text = " ".join((DOCS / "attribution.md").read_text().split())
    effect, error = JUDGED["effects"][0], JUDGED["error"]
    level = effect["parameters"]["level"]
    for shown in (
        f"{1e3 * error['before']:.2f} mrad",
        f"**{1e3 * error['after']:.2f} mrad**",
        f"{1e3 * level['value']:.2f} mN m",
        f"[{1e3 * level['low']:.1f}, {1e3 * level['high']:.1f}]",
        f"{100 * effect['held_out_gain']:.0f} % off the squared error",
        f"{effect['better']} of {effect['folds']}",
        f"p is {effect['p_value']:g}",
    ):
        assert shown in text, shown
    assert (effect["name"], JUDGED["verdict"]) == ("coulomb", "explained")
    dropped = next(step for step in JUDGED["trace"] if step[0] == "dropped")
    assert dropped[1] == "encoder_scale" and "p 0.93" in dropped[3]
    assert [one["name"] for one in JUDGED["instead"]] == ["stribeck", "friction_drift"]
    assert JUDGED["test"]["largest_random"] < JUDGED["test"]["sum"]


def test_the_example_shows_every_rule():
    source = (DOCS / "attribution.md").read_text()
    shown = HOOKS["with_rules"](source)
    assert HOOKS["RULES"] in source and HOOKS["RULES"] not in shown
    assert all(f"| `{rule.code}` |" in shown for rule in RULES)


def test_pages_are_short():
    assert len((DOCS / "attribution.md").read_text().split()) <= 1500
    for name in BY_ROBOT:
        assert len(page_of(name).read_text().split()) <= 800, name


@pytest.mark.parametrize("name", BY_ROBOT)
def test_every_block_of_a_robot_runs_or_says_that_it_needs_the_robot(name):
    fences = [f for f in re.findall(r"^```.*$", page_of(name).read_text(), re.M) if f != "```"]
    data = [f for f in fences if f.startswith("```{.toml ")]
    run = [f for f in fences if f in ("```bash", "```python")]
    marked = [f for f in fences if NOT_RUN.match(f)]
    assert run and marked and len(data) + len(run) + len(marked) == len(fences)


def test_stand_ins_compile():
    for text in STAND_INS.values():
        mujoco.MjModel.from_xml_string(text)


@pytest.mark.slow
@pytest.mark.parametrize("name", BY_ROBOT)
def test_a_page_by_robot_runs(name, tmp_path):
    for file, text in STAND_INS.items():
        (tmp_path / file).write_text(text)
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    RUN["run_page"](page_of(name), tmp_path)
    assert (tmp_path / "next" / "motion.csv").exists()


READERS = ("robot", "environment", "research")


def commands_of(reader: str) -> list[str]:
    """The commands that the README shows to a reader."""
    parts = (ROOT / "README.md").read_text().split("\n## You ")
    part = next(part for part in parts if reader in part.partition("\n")[0])
    return re.findall(r"^    (adaptsim .*)$", part.partition("\n## ")[0], re.M)


@pytest.mark.parametrize("reader", READERS)
def test_each_reader_is_shown_two_commands(reader):
    assert len(commands_of(reader)) == 2


@pytest.mark.slow
@pytest.mark.parametrize("reader", READERS)
def test_commands_of_the_readme_run(reader, tmp_path):
    """Minutes each: as they stand, in a folder with what a checkout has."""
    for name in ("adaptsim_jax", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    RUN["bash"]("\n".join(commands_of(reader)), tmp_path)


@pytest.mark.slow
def test_what_an_agent_is_told_runs(tmp_path):
    """The machine and logs are those of the tutorial."""
    tutorial = RUN["BLOCK"].findall((DOCS / "tutorials" / "diagnose.md").read_text())
    RUN["python"](tutorial[0][1], {"__name__": "__main__"}, tmp_path)
    printed = RUN["run_page"](ROOT / "SKILL.md", tmp_path)
    assert "coulomb shoulder" in printed[-2] and "skill" in printed[-1]


@pytest.mark.parametrize("file", ["llms.txt", "SKILL.md", "SECURITY.md", "README.md"])
def test_links_of_pages_beside_the_site_lead_somewhere(file):
    links = re.findall(r"\]\((?!https?:)([^)#]+)", (ROOT / file).read_text())
    assert all((ROOT / link).exists() for link in links), links


def test_issue_templates_ask_for_the_report():
    folder = ROOT / ".github" / "ISSUE_TEMPLATE"
    assert all("report.json" in path.read_text() for path in folder.glob("*.md"))
    assert len(list(folder.glob("*.md"))) == 3
