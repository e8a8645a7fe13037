"""URDF before MuJoCo reads it: checked in its own words, and without what only drawing and contact
need.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptsim_jax.core.errors import BadInput, brief

MOVING = ("revolute", "continuous", "prismatic")
SIX = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
TINY = 1e-6
MIN_INERTIA = 1e-12
"""kg, kg m^2: more than MuJoCo's least, and nothing beside any machine."""


@dataclass(frozen=True)
class Follower:
    """A joint at offset + factor * (angle of its leader), both in rad or m."""

    joint: str
    leader: str
    factor: float
    offset: float


@dataclass(frozen=True)
class Urdf:
    """A URDF as MuJoCo can read it; what it cannot hold: `mimics`, and links `weightless` that got
    a little inertia; `notes`.
    """

    text: str
    mimics: tuple[Follower, ...]
    weightless: tuple[str, ...]
    notes: tuple[str, ...]


def is_urdf(where: str, text: str) -> bool:
    """Whether the root is <robot> and not <mujoco>. Raises BadInput where it is neither, or the
    text is no XML.
    """
    try:
        tag = ElementTree.fromstring(text).tag
    except ElementTree.ParseError as error:
        raise BadInput(f"{where}: is no well-formed XML ({error}); mend that line") from None
    if tag not in ("robot", "mujoco"):
        raise BadInput(
            f"{where}: its root is <{tag}>; give an MJCF file, whose root is <mujoco>, or a URDF, "
            "whose root is <robot>"
        )
    return tag == "robot"


def urdf_for_mujoco(where: str, text: str) -> Urdf:
    """The URDF without shapes, materials and extensions, but for MuJoCo's own compiler. Raises
    BadInput for what is not modelled.
    """
    robot = ElementTree.fromstring(text)
    for element in robot.iter():
        if isinstance(element.tag, str) and "xacro" in element.tag:
            raise BadInput(
                f"{where}: holds xacro commands; expand it first (xacro robot.urdf.xacro > "
                "robot.urdf)"
            )
        for key, value in element.attrib.items():
            if "${" in value or "$(" in value:
                raise BadInput(
                    f"{where}: <{element.tag} {key}={value!r}> was left by xacro; expand the file "
                    "it comes from (xacro robot.urdf.xacro > robot.urdf), or write the number"
                )
    links = {link.get("name", ""): link for link in robot.findall("link")}
    joints = robot.findall("joint")
    for joint in joints:
        _check_joint(where, joint, links)
    notes = _drop_duplicates(robot)
    mimics = _mimics(where, joints)
    compiler_element = robot.find("mujoco/compiler")
    compiler = {} if compiler_element is None else dict(compiler_element.attrib)
    weightless = _inertias(where, links, joints, compiler, notes)
    notes += _placeholders(joints)
    for child in list(robot):
        if child.tag not in ("link", "joint"):
            robot.remove(child)
    for link in links.values():
        for child in list(link):
            if child.tag != "inertial":
                link.remove(child)
    _free_world(links, joints)
    extension = ElementTree.Element("mujoco")
    ElementTree.SubElement(
        extension, "compiler", compiler | {"fusestatic": "false", "discardvisual": "true"}
    )
    robot.insert(0, extension)
    return Urdf(ElementTree.tostring(robot, encoding="unicode"), mimics, weightless, tuple(notes))


def _drop_duplicates(robot: Any) -> list[str]:
    """Remove elements that stand twice in a link or joint: the first counts, as in ROS' own parser.
    Returns a note on each.
    """
    notes = []
    for owner in (*robot.findall("link"), *robot.findall("link/inertial"), *robot.findall("joint")):
        for tag in ("origin", "mass", "inertia", "inertial", "axis", "limit", "dynamics", "mimic"):
            for extra in owner.findall(tag)[1:]:
                owner.remove(extra)
                name = owner.get("name") or next(
                    (k.get("name") for k in robot.findall("link") if k.find("inertial") is owner),
                    "",
                )
                notes.append(f"<{tag}> stands twice in '{name}': the first counts, as in ROS")
    return notes


def _number(where: str, joint: str, element: Any, key: str, default: float) -> float:
    try:
        return float(element.get(key, default))
    except ValueError:
        raise BadInput(
            f"{where}: joint '{joint}' has {key} = {brief(element.get(key))}; give a number"
        ) from None


def _mimics(where: str, joints: list) -> tuple[Follower, ...]:
    names = {j.get("name") for j in joints if j.get("type") in MOVING}
    out = []
    for joint in joints:
        mimic, name = joint.find("mimic"), joint.get("name")
        if mimic is None or joint.get("type") not in MOVING:
            continue
        leader = mimic.get("joint")
        if leader not in names or leader == name:
            raise BadInput(
                f"{where}: joint '{name}' mimics {brief(leader)}, which is no other joint that "
                "moves; mend the name"
            )
        factor = _number(where, name, mimic, "multiplier", 1.0)
        if factor == 0.0:
            raise BadInput(
                f"{where}: joint '{name}' mimics '{leader}' with multiplier 0; make it fixed"
            )
        out.append(Follower(name, leader, factor, _number(where, name, mimic, "offset", 0.0)))
        joint.remove(mimic)
    return tuple(out)


def _check_joint(where: str, joint: Any, links: dict[str, Any]) -> None:
    name, kind = joint.get("name"), joint.get("type")
    if kind not in (*MOVING, "fixed", "floating"):
        raise BadInput(
            f"{where}: joint '{name}' is of type {brief(kind)}; write single joints in its place"
        )
    for end in ("parent", "child"):
        element = joint.find(end)
        if element is None or element.get("link") not in links:
            if element is None:
                named = ""
            else:
                named = f" {brief(element.get('link'))}"
            raise BadInput(
                f"{where}: joint '{name}' has a {end} link{named} that the file lacks; add it or "
                "mend the name"
            )


def _carrying(
    with_mass: set[str], carrier_of: Callable[[str], str | None], max_depth: int
) -> set[str]:
    """Return the bodies that weigh something, and those that carry one of them."""
    carriers = set()
    for body in with_mass:
        link: str | None = body
        for _ in range(max_depth):
            if link is None:
                break
            carriers.add(link)
            link = carrier_of(link)
    return carriers


def _bodies(
    where: str, links: dict[str, Any], moving_link: Callable[[str], str | None]
) -> dict[str, list[str]]:
    """Group links by the one that moves them; those that stand still lose their inertia."""
    bodies: dict[str, list[str]] = {}
    for name, link in links.items():
        mover = moving_link(name)
        if mover is not None:
            bodies.setdefault(mover, []).append(name)
            continue
        for inertial in link.findall("inertial"):
            link.remove(inertial)
    for name in (n for names in bodies.values() for n in names):
        if _mass(links[name]) < 0.0:
            raise BadInput(
                f"{where}: link '{name}' has a negative mass ({_mass(links[name]):g}); mend its "
                "sign"
            )
    return bodies


def _inertias(
    where: str, links: dict[str, Any], joints: list, compiler: dict, notes: list[str]
) -> tuple[str, ...]:
    """Give links without inertia that carry something, and points without moments, as little as
    MuJoCo reads; return the former. Links that are fixed to each other are one body, and what
    stands still needs nothing.

    Raises BadInput where the last of a chain weighs nothing, or moments are negative.
    """
    parent = {
        j.find("child").get("link"): (j.find("parent").get("link"), j.get("type")) for j in joints
    }

    def moving_link(link: str) -> str | None:
        """The link of a body that moves; None where it stands still."""
        for _ in range(len(links) + 1):
            if link not in parent:
                return None
            up, kind = parent[link]
            if kind != "fixed":
                return link
            link = up
        return None

    bodies = _bodies(where, links, moving_link)
    with_mass = {body for body, names in bodies.items() if any(_mass(links[n]) > 0 for n in names)}
    carriers = _carrying(with_mass, lambda link: moving_link(parent[link][0]), len(links))
    if massless_ends := [body for body in bodies if body not in carriers]:
        raise BadInput(
            f"{where}: no mass for link{'s' if len(massless_ends) > 1 else ''} "
            f"{', '.join(massless_ends)}, nor for what it carries; give each that moves an "
            "<inertial> with mass and inertia"
        )
    unphysical_links = [
        name
        for body in bodies
        if body in with_mass
        for name in _complete_moments(where, links, bodies[body], compiler)
    ]
    if unphysical_links:
        compiler["balanceinertia"] = "true"
        notes.append(
            "moments of inertia that no body can have (the largest is more than the other two "
            f"together), balanced as MuJoCo does: {', '.join(unphysical_links)}"
        )
    massless = [body for body in bodies if body not in with_mass]
    for body in massless:
        for inertial in links[body].findall("inertial"):
            links[body].remove(inertial)
        links[body].append(_inertial(MIN_INERTIA, MIN_INERTIA))
    return tuple(massless)


def _complete_moments(
    where: str, links: dict[str, Any], names: list[str], compiler: dict
) -> list[str]:
    """Make masses without moments points, and return the links whose moments no body can have.

    Raises BadInput where moments are negative.
    """
    unphysical_links = []
    for name in names:
        inertial, inertia = links[name].find("inertial"), links[name].find("inertial/inertia")
        if _mass(links[name]) <= 0.0:
            for massless_inertial in links[name].findall("inertial"):
                links[name].remove(massless_inertial)
            continue
        values = {k: 0.0 if inertia is None else _number(where, name, inertia, k, 0.0) for k in SIX}
        if inertia is None:
            inertia = ElementTree.SubElement(inertial, "inertia")
        for k in SIX:
            is_degenerate = k[1] == k[2] and not any(
                values[other] for other in SIX if k[1] in other[1:]
            )  # a point, or along a rod
            inertia.set(k, f"{MIN_INERTIA:g}" if is_degenerate else repr(values[k]))
        xx, xy, xz, yy, yz, zz = (values[k] for k in SIX)
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if compiler.get("balanceinertia") == "true":
            continue
        if moments[0] < -TINY * abs(moments[2]):
            negative = [f"{k} = {values[k]:g}" for k in ("ixx", "iyy", "izz") if values[k] < 0.0]
            if not negative:
                negative = [f"{moments[0]:.3g} about a main axis"]
            raise BadInput(
                f"{where}: link '{name}' has negative moments of inertia ({', '.join(negative)}); "
                "mend their sign"
            )
        if moments[0] + moments[1] < moments[2] * (1.0 - TINY):
            unphysical_links.append(name)
    return unphysical_links


def _inertial(mass: float, moment: float) -> Any:
    out = ElementTree.Element("inertial")
    ElementTree.SubElement(out, "mass", value=f"{mass:g}")
    ElementTree.SubElement(out, "inertia", {k: f"{moment if k[1] == k[2] else 0.0:g}" for k in SIX})
    return out


def _mass(link: Any) -> float:
    mass = link.find("inertial/mass")
    try:
        if mass is None:
            return 0.0
        return float(mass.get("value", 0))
    except ValueError:
        return 1.0  # MuJoCo's parser says what is wrong with the number


def _placeholders(joints: list) -> list[str]:
    """Return a note on each joint whose friction is as large as its effort limit, so that it never
    moves: a number that was put in for want of one.
    """
    notes = []
    for joint in joints:
        limit, dynamics = joint.find("limit"), joint.find("dynamics")
        try:
            effort = 0.0 if limit is None else float(limit.get("effort", 0))
            if dynamics is None:
                friction = 0.0
            else:
                friction = float(dynamics.get("friction", 0))
        except ValueError:
            continue
        if friction > 0.0 and friction >= effort > 0.0:
            notes.append(
                f"joint '{joint.get('name')}' declares friction of {friction:g}, as much as its "
                "effort limit: it could not move; put in a measured friction, or 0"
            )
    return notes


def _free_world(links: dict[str, Any], joints: list) -> None:
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
