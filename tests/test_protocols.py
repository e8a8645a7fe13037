"""What every registered task, mechanism, effect, engine, learner and baseline promises, ours and
those of installed packages.

Pure functions are traced under `jit` and `vmap` in both precisions and not compiled
(`jax.eval_shape`): that is where a shape, a dtype or a branch on a value goes wrong. Numbers are
the tests' of each room.
"""

import dataclasses
import importlib
import importlib.util
import inspect
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import adaptsim_jax
import adaptsim_jax.diagnosis
from adaptsim_jax.baselines.arena import Visits
from adaptsim_jax.baselines.registry import EXACT, LEARNED, PROBLEMS, STEPS
from adaptsim_jax.effects.base import PLACES, UNITS, Dry, Motion, of_the_engine
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.learners.bdq import BDQConfig, BDQHyper, make_bdq
from adaptsim_jax.learners.naf import NAFConfig, NAFHyper, make_naf
from adaptsim_jax.learners.replay import Transition
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.engine import EngineKind
from adaptsim_jax.tasks.registry import TASKS

ROOT = Path(__file__).parents[1]
BATCH = 3
UNIT = (
    "kg",
    "m/s",
    "rad",
    "N m",
    " s",
    " m",
    "[",
    "unit",
)  # a public docstring names units, or shapes
LISTS = [adaptsim_jax, adaptsim_jax.diagnosis]


@pytest.fixture(params=[False, True], ids=["float32", "x64"])
def real(request):
    """The dtype of real numbers, with JAX set to it."""
    with jax.enable_x64(request.param):
        yield jnp.float64 if request.param else jnp.float32


def batched(function, *args, axes=0):
    """Shapes of `jit(vmap(function))` over a first axis of `BATCH`, which must be there in every
    leaf.
    """
    out = jax.eval_shape(jax.jit(jax.vmap(function, axes, axis_size=BATCH)), *args)
    assert all(leaf.shape[0] == BATCH for leaf in jax.tree.leaves(out))
    return out


def floats(tree):
    return {
        leaf.dtype for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.floating)
    }


def explained(thing, *, shapes=False):
    """A docstring that is more than a label; of what takes arrays, one that gives units or
    shapes.
    """
    text = inspect.getdoc(thing) or ""
    assert len(text) > 20, thing
    assert not shapes or any(u in text for u in UNIT), f"{thing}: no unit and no shape in {text!r}"


@pytest.mark.parametrize("package", LISTS, ids=lambda p: p.__name__)
def test_the_public_list_loads_and_is_explained(package):
    assert (
        len(package.__all__) == len(set(package.__all__))
        and sorted(package.__all__) == package.__all__
    )
    for name in package.__all__:
        thing = getattr(package, name)
        explained(thing)
        home = importlib.import_module(thing.__module__)
        assert getattr(home, name) is thing and thing.__module__.startswith("adaptsim_jax.")
    assert not hasattr(package, "nothing_of_this_name") and set(package.__all__) <= set(
        dir(package)
    )


def test_there_are_few_public_names():
    assert sum(len(p.__all__) for p in LISTS) <= 46


def test_documents_import_what_there_is():
    """Every `from adaptsim_jax import ...` of a page, from the public list or from a module that
    has the name.
    """
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        for module, names in re.findall(
            r"^ *from (adaptsim_jax[\w.]*) import ([\w, ]+)", page.read_text(), flags=re.M
        ):
            for name in (n.split(" as ")[0].strip() for n in names.split(",")):
                there = importlib.import_module(module)
                known = there.__all__ if there in LISTS else dir(there)
                assert name in known or importlib.util.find_spec(f"{module}.{name}"), (
                    f"{page.name}: {module} has no {name}"
                )


def test_importing_the_package_loads_no_library():
    """Of what is slow to import: `import adaptsim_jax` takes 0.02 s so, and 1 s with JAX."""
    code = (
        "import adaptsim_jax, adaptsim_jax.diagnosis, sys; print([m for m in ('jax', 'numpy', "
        "'scipy') if m in sys.modules])"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout
        == "[]\n"
    )


LONG = ("environment",)  # tasks whose policies take ten seconds and more to compile


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.long) if n in LONG else n for n in TASKS]
)
def test_task(name, real):
    kind = TASKS[name]
    explained(kind.config)
    explained(kind.make)
    assert dataclasses.is_dataclass(kind.config) and kind.config.__dataclass_params__.frozen
    task = kind.make(kind.config())
    assert task.name == name and task.settings
    for setting, values in task.settings.items():
        assert task.space.values(values, setting).shape == (task.space.dim,)
    keys = jax.random.split(jax.random.key(0), BATCH)
    means = jnp.full((BATCH, task.space.dim), 0.5, jnp.float32)
    params = jax.vmap(task.space.physical)(means)
    policies = batched(task.init_policy, keys)
    dists = jax.vmap(lambda m: gaussian(task.space, m))(means)
    trained = batched(task.train, keys, dists, policies)
    assert jax.tree.structure(trained) == jax.tree.structure(policies)
    assert [x.shape for x in jax.tree.leaves(trained)] == [
        x.shape for x in jax.tree.leaves(policies)
    ]
    for rollout in filter(None, (task.rollout, task.rehearse)):
        trajectories = batched(rollout, keys, trained, params)
        assert batched(task.observe, trajectories).shape == (BATCH, task.obs_dim)
        assert batched(task.score, trajectories).shape == (BATCH,)
        reward = batched(task.reward, trajectories, batched(task.reference, params))
        assert reward.shape == (BATCH,) and jnp.issubdtype(reward.dtype, jnp.floating)


EVERY_EFFECT = [(f"machine.{e.name}", e) for e in MACHINE]


@pytest.mark.parametrize("effect", [e for _, e in EVERY_EFFECT], ids=[n for n, _ in EVERY_EFFECT])
def test_effect(effect, real):
    assert effect.place in PLACES and effect.physics and effect.excitation and effect.formula
    assert all(p.unit in UNITS for p in effect.parameters)
    rows, joints = 7, 2

    def of(*shape):
        return jax.ShapeDtypeStruct((BATCH, *shape), real)

    p = {x.name: of(1, 1) for x in effect.parameters}
    motion = {x: of(joints, rows) for x in ("q", "v", "u", "pull", "target")} | {"t": of(1, rows)}
    if effect.place == "model":  # has no function: its parameters are the engine's own
        assert effect.apply is of_the_engine and effect.parameters
    elif effect.inertia or effect.place == "drive":
        assert floats(batched(effect.apply, p)) == {jnp.dtype(real)}
    elif effect.place == "force":

        def there(m):
            return Motion(**m, gravity=lambda q: -q)

        answer = batched(lambda p, m: effect.apply(p, there(m)), p, motion)
        force = answer.level if isinstance(answer, Dry) else answer
        assert force.shape == (BATCH, joints, rows) and floats(force) == {jnp.dtype(real)}
    elif effect.place == "command":
        out = batched(effect.apply, p, of(rows, joints), of(rows, joints))
        assert out.shape == (BATCH, rows, joints) and floats(out) == {jnp.dtype(real)}
    else:
        torque = (of(rows, joints),) if effect.carried else ()
        q, v = batched(effect.apply, p, *(of(rows, joints) for _ in range(3)), of(joints), *torque)
        assert q.shape == v.shape == (BATCH, rows, joints) and floats((q, v)) == {jnp.dtype(real)}


ENGINES = [(task, name) for task in TASKS for name in TASKS[task].backends]


@pytest.mark.parametrize(("task", "name"), ENGINES)
def test_engine(task, name):
    kind = TASKS[task].backends[name]
    assert isinstance(kind, EngineKind)
    explained(sys.modules[kind.make.__module__])
    settings = kind.settings()  # all have defaults
    assert list(inspect.signature(kind.make).parameters)[1:] == list(settings._fields)
    assert all(field in (kind.settings.__doc__ or "") for field in settings._fields)


@pytest.mark.parametrize("name", TASKS["pendulum"].backends)
def test_engine_answers_in_shape(name):
    """Of the pendulum's, which are quick to make; the others' are in tests/tasks."""
    if name == "drake":
        pytest.importorskip("pydrake", reason="Drake is an extra")
    if name == "mjx":
        pytest.skip("takes ten seconds to compile; tests/tasks/pendulum runs it")
    simulate = adaptsim_jax.make_backend("pendulum", name, 2e-3).simulate
    params = np.array([[1.0, 0.8, 0.4, 0.3, 0.2, 0.15, 0.02, 0.01, 0.1, 0.1]] * 2)
    out = simulate(params, np.zeros((2, 4, 2)), np.array([[0.1, 0.0, 0.0, 0.0]] * 2))
    assert (
        out.state.shape == (2, 4, 4) and out.code.shape == (2,) and not np.asarray(out.code).any()
    )
    assert 0 < np.asarray(out.state)[0, -1, 0] < 0.1  # it falls towards hanging


MADE = {
    "bdq": (make_bdq, BDQConfig(4, 2), BDQHyper(), lambda n: jnp.zeros((n, 2), jnp.int32), (0.1,)),
    "naf": (make_naf, NAFConfig(4, 2), NAFHyper(), lambda n: jnp.zeros((n, 2)), (0.1,)),
}


@pytest.mark.parametrize("name", MADE)
def test_learner(name, real):
    make, config, hyper, actions, noise = MADE[name]
    explained(make, shapes=True)
    explained(type(hyper), shapes=True)
    learner = make(config)
    keys, obs = jax.random.split(jax.random.key(0), BATCH), jnp.zeros((BATCH, 5, 4), jnp.float32)
    states = batched(learner.init, keys)
    assert batched(
        lambda k, s, o: learner.act(k, s.online, o, *noise), keys, states, obs
    ).shape == (BATCH, 5, 2)
    one = Transition(jnp.zeros((5, 4)), actions(5), jnp.zeros(5), jnp.zeros((5, 4)), jnp.zeros(5))
    batch = jax.tree.map(
        lambda x: jnp.stack([x.astype(jnp.float32) if x.dtype == jnp.float64 else x] * BATCH), one
    )
    after, info = batched(lambda s, b: learner.update(s, b, hyper), states, batch)
    assert jax.tree.map(lambda x: (x.shape, x.dtype), after) == jax.tree.map(
        lambda x: (x.shape, x.dtype), states
    )
    assert info.loss.shape == (BATCH,)


@pytest.mark.parametrize("baselines", [EXACT, LEARNED, STEPS], ids=["exact", "learned", "steps"])
def test_baselines(baselines):
    for name in baselines:
        signature = inspect.signature(baselines[name])
        first, *rest = signature.parameters.values()
        kinds = [getattr(a, "__name__", a) for a in (first.annotation, signature.return_annotation)]
        assert kinds == ["MethodRun", "Visits"], name
        assert all(p.default is not p.empty for p in rest), f"{name} is called with one argument"
        explained(sys.modules[baselines[name].__module__])
    explained(Visits, shapes=True)


@pytest.mark.parametrize("name", PROBLEMS)
def test_problem(name, real):
    explained(PROBLEMS[name])
    problem = PROBLEMS[name](TASKS[name].make(TASKS[name].config()).space)
    params = jax.ShapeDtypeStruct((BATCH, problem.space.dim), real)
    policy = batched(problem.policy, params)
    for cost in (problem.cost, lambda p, k: problem.mean_cost(p, k)):
        assert batched(cost, params, policy).shape == (BATCH,)
    value, slope = batched(problem.slope, params, params)
    assert (
        value.shape == (BATCH,)
        and slope.shape == params.shape
        and floats((value, slope)) == {jnp.dtype(real)}
    )
