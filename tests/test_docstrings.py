"""What a docstring says of arguments, fields and other names is said of those that are there."""

import ast
import re
from pathlib import Path

import adaptsim_jax

PACKAGE = Path(adaptsim_jax.__file__).parent
TREES = {file: ast.parse(file.read_text()) for file in sorted(PACKAGE.rglob("*.py"))}
ARGUMENT = re.compile(r"^    (\w[\w, ]*):(?: |$)", re.MULTILINE)
FIELDS = re.compile(r"^- ((?:`[^`]+`(?:, )?)+)", re.MULTILINE)
QUOTED = re.compile(r"`([A-Za-z_]\w*(?:\.\w+)*)`")
WORD = re.compile(r"[A-Za-z_]\w*")
FOREIGN = """Action Data MotorNormMode PARAMETER dynamic_update_slice l_i permutation qfrc_gravcomp
randomization_fn sortable"""
"""Names of other packages, of formulas and of pages."""
EXAMPLES = """command_delay elbow_vel_deg_s i1_A joint_2_pos left_elbow position0 position_A q3
q_elbow run_control run_state shoulder_vel t_ms target_NAME target_elbow tau_NAME v_NAME"""
"""Names that files of users may have."""


def documented(node: ast.AST) -> str:
    """A docstring without shapes and arguments of calls, '' for none."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module):
        return re.sub(r"\[[^]`]*\]|\([^)`]*\)|->.*", "", ast.get_docstring(node) or "")
    return ""


def own_names(node: ast.AST) -> set[str]:
    """Arguments of a function; all that a class names."""
    if isinstance(node, ast.FunctionDef):
        node = node.args
    return {word for n in ast.walk(node) for word in words(n)}


def words(node: ast.AST) -> list[str]:
    """Names and words that a node holds itself."""
    held = [getattr(node, key, None) for key in ("id", "attr", "arg", "name", "module", "value")]
    return [word for text in held if isinstance(text, str) for word in WORD.findall(text)]


def argument_names(text: str) -> set[str]:
    """Names under `Args:`, and those that bullets begin with."""
    _, _, arguments = text.partition("Args:\n")
    lines = ARGUMENT.findall(re.split(r"^\S", arguments, flags=re.MULTILINE)[0])
    return {word for line in (*lines, *FIELDS.findall(text)) for word in WORD.findall(line)}


def all_names() -> set[str]:
    """Words of the package: names, words of strings that are no docstrings, of files and tables."""
    found = {*FOREIGN.split(), *EXAMPLES.split()}
    found |= {word for file in TREES for word in WORD.findall(str(file.relative_to(PACKAGE)))}
    for tree in TREES.values():
        texts = {id(n.body[0].value) for n in ast.walk(tree) if documented(n)}
        found |= {w for n in ast.walk(tree) if id(n) not in texts for w in words(n)}
    return found.union(*(WORD.findall(p.read_text()) for p in PACKAGE.rglob("*.toml")))


def test_names_in_docstrings_exist():
    wrong, existing = [], all_names()
    for file, tree in TREES.items():
        for node in ast.walk(tree):
            if text := documented(node):
                arguments = argument_names(text)
                unknown = arguments - own_names(node) if arguments else set()
                quoted = {word for code in QUOTED.findall(text) for word in WORD.findall(code)}
                name = f"{file.relative_to(PACKAGE)}: {getattr(node, 'name', 'module')}"
                wrong += [f"{name}: {word}" for word in unknown | (quoted - existing)]
    assert not wrong
