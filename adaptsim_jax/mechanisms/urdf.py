"""URDF before MuJoCo reads it: checked in its own words, and without what only drawing and contact need."""

import xml.etree.ElementTree as ElementTree
from typing import Any

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.given import brief

MOVING = ("revolute", "continuous", "prismatic")


def is_urdf(where: str, text: str) -> bool:
    """Whether the root is <robot> and not <mujoco>. Raises BadInput where it is neither, or the text is no XML."""
    try:
        tag = ElementTree.fromstring(text).tag
    except ElementTree.ParseError as error:
        raise BadInput(f"{where}: is no well-formed XML ({error}); mend that line") from None
    if tag not in ("robot", "mujoco"):
        raise BadInput(
            f"{where}: its root is <{tag}>; give an MJCF file, whose root is <mujoco>, or a URDF, whose root is <robot>"
        )
    return tag == "robot"


def urdf_for_mujoco(where: str, text: str) -> str:
    """The URDF without shapes, materials and extensions. Raises BadInput for what is not modelled."""
    robot = ElementTree.fromstring(text)
    for element in robot.iter():
        if isinstance(element.tag, str) and "xacro" in element.tag:
            raise BadInput(f"{where}: holds xacro commands; expand it first (xacro robot.urdf.xacro > robot.urdf)")
    links = {link.get("name", ""): link for link in robot.findall("link")}
    joints = robot.findall("joint")
    for joint in joints:
        _check_joint(where, joint, links)
    _check_inertias(where, links, joints)
    for child in list(robot):
        if child.tag not in ("link", "joint"):
            robot.remove(child)
    for link in links.values():
        for child in list(link):
            if child.tag != "inertial":
                link.remove(child)
    _free_world(robot, links, joints)
    extension = ElementTree.Element("mujoco")
    ElementTree.SubElement(extension, "compiler", fusestatic="false", discardvisual="true")
    robot.insert(0, extension)
    return ElementTree.tostring(robot, encoding="unicode")


def _check_joint(where: str, joint: Any, links: dict[str, Any]) -> None:
    name, kind = joint.get("name"), joint.get("type")
    if joint.find("mimic") is not None:
        leader = joint.find("mimic").get("joint")
        raise BadInput(
            f"{where}: joint '{name}' mimics '{leader}', which is not modelled; make it fixed, or a joint of its own"
        )
    if kind not in (*MOVING, "fixed"):
        mend = (
            "make it fixed, as the base hung in the experiment"
            if kind == "floating"
            else "write single joints in its place"
        )
        raise BadInput(f"{where}: joint '{name}' is of type {brief(kind)}; {mend}")
    for end in ("parent", "child"):
        element = joint.find(end)
        if element is None or element.get("link") not in links:
            named = "" if element is None else f" {brief(element.get('link'))}"
            raise BadInput(
                f"{where}: joint '{name}' has a {end} link{named} that the file lacks; add it or mend the name"
            )


def _check_inertias(where: str, links: dict[str, Any], joints: list) -> None:
    """Links that are fixed to each other are one body; each that moves needs a mass and an inertia."""
    fixed = {j.find("child").get("link"): j.find("parent").get("link") for j in joints if j.get("type") == "fixed"}

    def head(link: str) -> str:
        seen = set()
        while link in fixed and link not in seen:
            seen.add(link)
            link = fixed[link]
        return link

    weighed = {head(name) for name, link in links.items() if _weighs(link)}
    moved = [j.find("child").get("link") for j in joints if j.get("type") in MOVING]
    bare = [name for name in moved if head(name) not in weighed]
    if bare:
        raise BadInput(
            f"{where}: no inertia for link{'s' if len(bare) > 1 else ''} {', '.join(bare)}; give each that moves an <inertial> "
            "with mass and inertia"
        )


def _weighs(link: Any) -> bool:
    mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
    if mass is None or inertia is None:
        return False
    try:
        return float(mass.get("value", 0)) > 0 and any(float(inertia.get(k, 0)) > 0 for k in ("ixx", "iyy", "izz"))
    except ValueError:
        return True  # MuJoCo's parser says what is wrong with the number


def _free_world(robot: Any, links: dict[str, Any], joints: list) -> None:
    """MuJoCo calls its own fixed body 'world', so that a link of that name needs another."""
    if "world" not in links:
        return
    name = "world_link"
    while name in links:
        name += "_"
    links["world"].set("name", name)
    for joint in joints:
        for end in ("parent", "child"):
            if joint.find(end).get("link") == "world":
                joint.find(end).set("link", name)
