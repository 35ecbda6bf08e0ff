"""Fitted models on disk: what was written comes back, and damaged files are refused in one sentence."""

import dataclasses as dc
import json
from pathlib import Path
from typing import ClassVar

import equinox as eqx
import numpy as np
import pytest

import ddetumble as dd
from ddetumble._errors import InputError
from ddetumble.contact.effect import AbstractModel
from ddetumble.contact.law import Ball
from ddetumble.effects import IMPACT
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact_campaigns import make_campaign
from ddetumble.inference.archive import _choose, load, make_fitted, resolve_model, save_model
from ddetumble.inference.models import resolve_effect
from ddetumble.inference.noise import Noise
from ddetumble.inference.parameters import ParameterSpace
from ddetumble.inference.problem import Solution
from ddetumble.measurement.package import read_campaign


USER = '''"""An effect of the user."""

from typing import ClassVar

from ddetumble.contact.effect import AbstractElasticEffect, Contact, Scalar, parameter


class Felt(AbstractElasticEffect):
    """A layer of felt."""

    k_f: Scalar = parameter("N/m", 0.0, typical=100.0)
    id: ClassVar[str] = "felt"
    law: ClassVar[str] = "F_k gains k_f delta"
    reference: ClassVar[str] = "ours"

    def force(self, contact: Contact) -> Scalar:
        """k_f delta [N]."""
        return self.k_f * contact.depression
'''
NOISE = {"normal_force": Noise(0.25, 0.3, 0.2, 5e-4, 0.25, 0.03, "correlated")}


def make_solution(space, names, values):
    u = space.coordinates(values)
    count, empty = len(names), np.zeros((1, 3, 0))
    shared = np.random.default_rng(0).normal(size=(1, 3, count))
    return Solution(tuple(names), u, np.zeros((1, 0)), np.ones(count), np.zeros((1, 3)), shared, empty,
                    np.zeros((1, 1, 3)), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(1), np.zeros(count),
                    np.zeros(count), 3.0, True, 4, ())


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    place = tmp_path_factory.mktemp("archive") / "c"
    made = make_campaign("c", 3, {}, {"effective_mass": 1.3, "restitution": 0.7}, [6e5, 1e6], [0.3], 1, interval=2e-3)
    write_package(place, made)
    return read_campaign(place)


@pytest.fixture
def saved(campaign, tmp_path):
    space = ParameterSpace(Ball(doubled_core=True), IMPACT)
    solution = make_solution(space, ["effective_mass", "sensor-highpass.tau_s"],
                             {"effective_mass": 1.4, "sensor-highpass.tau_s": 0.8})
    save_model(tmp_path / "m", make_fitted(
        campaign=campaign, model_name="paper-doubled-core", space=space, solution=solution, noise=NOISE,
        effects=["sensor-highpass"], extra={"verdict": "explained"}))
    return tmp_path / "m", solution


def test_what_was_written_comes_back(saved, campaign):
    folder, solution = saved
    model = load(folder)
    assert model.effects == ("sensor-highpass",) and model.free == solution.names
    assert model.space.reference.doubled_core and len(model.space) == 5
    np.testing.assert_array_equal(model.covariance, solution.covariance())
    assert dict(model.noise) == NOISE and model.channels == ("normal_force",)
    assert float(model.law().reference.effective_mass) == pytest.approx(1.4)
    assert float(model.law().effects[0].decay_rate) == pytest.approx(0.8)
    assert model.uncertainties["initial_pressure"].relative == pytest.approx(0.005) and model.time_sd == 5e-5
    assert "sequence" not in model.uncertainties and model.sha256 == campaign.sha256
    assert model.extra["verdict"] == "explained" and model.notes == () and "jax" in model.versions
    assert model.ranges["approach_speed"][0] == pytest.approx(campaign.records["approach_speed"].min())
    assert model.outside({"approach_speed": 0.3, "initial_pressure": 8e5}) == []
    assert "initial_pressure" in model.outside({"approach_speed": 0.3, "initial_pressure": 5e6})[0]
    assert model.directions.shape == (2, 5)


def test_rates_that_were_never_measured_are_outside(tmp_path):
    """A tumbling record may start within what its gyroscope ever read, axis by axis, to either side."""
    model = dd.fit("tumble-a").fitted_model()
    fastest = dd.read_campaign("tumble-a").samples[list(model.channels)].abs().max()
    starts = [f"{channel}0" for channel in model.channels]
    for factor, far in ((0.99, []), (-0.99, []), (1.1, starts), (-1.1, starts)):
        exceeded = model.exceeded(dict(zip(starts, factor * fastest, strict=True)))
        assert list(exceeded) == far
        assert all(ends == (-fastest[name[:-1]], fastest[name[:-1]]) for name, ends in exceeded.items())
    assert len(model.outside(dict.fromkeys(starts, 10.0 * fastest.max()))) == 3


def test_held_parameters_that_came_later_stand_at_their_default(campaign, tmp_path):
    """A file that was written before an effect had a held shape is read as if the shape had been there."""
    space = ParameterSpace(Ball(), IMPACT)
    solution = make_solution(space, ["effective_mass", "wall-stiffness.k_w"], {"wall-stiffness.k_w": 300.0})
    save_model(tmp_path / "m", make_fitted(campaign=campaign, model_name="paper", space=space, solution=solution,
                                           noise=NOISE, effects=["wall-stiffness"]))
    content = json.loads((tmp_path / "m" / "model.json").read_text(encoding="utf-8"))
    wall = load(tmp_path / "m").law().effects[0]
    for name in ("wall-stiffness.q", "wall-stiffness.k_w"):
        del content["coordinates"][name]
        if name.endswith("k_w"):  # fitted with the effect: no file can lack it
            content["free"], content["covariance"] = ["effective_mass"], [[1.0]]
        (tmp_path / "m" / "model.json").write_text(json.dumps(content), encoding="utf-8")
        if name.endswith("q"):
            assert eqx.tree_equal(load(tmp_path / "m").law().effects[0], wall)
    with pytest.raises(InputError, match="wall-stiffness.k_w"):
        load(tmp_path / "m")


def test_noise_comes_back_without_the_sizes_of_its_samples(campaign, tmp_path):
    """Floor, shares and baseline are the noise's own; sizes belong to the samples it was measured on."""
    noise = Noise(0.25, 0.3, 0.2, 5e-4, 0.25, 0.03, "uneven", floor=0.1, share=0.01, rate_share=0.02, slow_sd=0.3,
                  slow_time=0.05, sizes={"r1": np.array([1.0, 2.0, 3.0])})
    space = ParameterSpace(Ball(), IMPACT)
    save_model(tmp_path / "m", make_fitted(
        campaign=campaign, model_name="paper", space=space, noise={"normal_force": noise}, effects=[],
        solution=make_solution(space, ["effective_mass"], {"effective_mass": 1.4}), widened={"effective_mass": 2.5}))
    again = load(tmp_path / "m")
    assert again.widened == {"effective_mass": 2.5}
    assert again.without_scatter().covariance == pytest.approx(again.covariance / 2.5**2)
    found = again.noise["normal_force"]
    assert (found.floor, found.share, found.rate_share, found.slow_sd, found.slow_time) == (0.1, 0.01, 0.02, 0.3, 0.05)
    assert found == noise and not found.sizes


@pytest.mark.slow
def test_a_model_of_every_family_comes_back(tmp_path):
    """Of oblique impacts, too, whose records are of the kind of impacts."""
    oblique = read_campaign(dd.find_data() / "oblique-a")
    short = dc.replace(oblique, samples=oblique.samples.iloc[::2])  # a size of which other tests compile the program
    for family, campaign in (("impact", "impact-a"), ("slip", "slip-a"), ("oblique", short), ("tumble", "tumble-a")):
        found = dd.fit(campaign)
        found.save(tmp_path / family)
        again = dd.load(tmp_path / family)
        assert again.family == found.fitted_model().family
        assert again.u == pytest.approx(found.fitted_model().u, rel=1e-12)


def test_a_folder_is_a_model(saved):
    resolved = resolve_model(str(saved[0]))
    assert resolved.name == "paper-doubled-core" and float(resolved.reference.effective_mass) == pytest.approx(1.4)
    assert [e.id for e in resolved.effects] == ["sensor-highpass"]


def test_effects_of_the_user_come_back_from_their_file(campaign, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(USER)
    felt = resolve_effect(f"{file}:Felt")
    assert resolve_effect(f"{file}:Felt") is felt
    space = ParameterSpace(Ball(), (*IMPACT, felt))
    solution = make_solution(space, ["felt.k_f"], {"felt.k_f": 80.0})
    save_model(tmp_path / "m", make_fitted(
        campaign=campaign, model_name="paper", space=space, solution=solution, noise=NOISE, effects=["felt"]))
    assert str(tmp_path) not in (tmp_path / "m" / "model.json").read_text()
    model = load(tmp_path / "m")
    assert type(model.law().effects[0]) is felt and float(model.law().effects[0].k_f) == 80.0
    file.write_text(USER + "\n# changed\n")
    assert "mine.py has changed" in load(tmp_path / "m").notes[0]
    file.unlink()
    with pytest.raises(InputError, match="mine.py"):
        load(tmp_path / "m")


def test_an_effect_without_a_file_is_given_again(campaign, tmp_path):
    namespace = {"__name__": "nowhere"}
    exec(USER, namespace)
    felt = namespace["Felt"]
    space = ParameterSpace(Ball(), (felt,))
    save_model(tmp_path / "m", make_fitted(
        campaign=campaign, model_name="paper", space=space,
        solution=make_solution(space, ["felt.k_f"], {"felt.k_f": 80.0}), noise=NOISE, effects=["felt"]))
    with pytest.raises(InputError, match="extra"):
        load(tmp_path / "m")
    assert load(tmp_path / "m", extra=[felt]).effects == ("felt",)


def _cut(text):
    return text[: len(text) // 2]


def _edit(**changes):
    def change(text):
        content = json.loads(text)
        for key, value in changes.items():
            content[key] = value
        return json.dumps(content)

    return change


@pytest.mark.parametrize(("spoil", "part"), [
    (_cut, "not a JSON file"),
    (lambda text: "", "not a JSON file"),
    (lambda text: "[]", "schema"),
    (_edit(schema="ddetumble.model/9"), "schema"),
    (_edit(covariance=[[1.0]]), "covariance"),
    (_edit(free=["effective_mass", "nothing"]), "free"),
    (_edit(model="nothing"), "no model"),
    (_edit(effects=[{"id": "nothing"}]), "nothing"),
    (_edit(coordinates={"effective_mass": 0.0}, free=[], covariance=[]), "coordinates"),
    (_edit(time_sd="a"), "time_sd"),
    (_edit(choices={"colour": 1}), "choices"),
    (_edit(colour=1), "colour"),
])  # fmt: skip
def test_damaged_files_are_refused_in_one_sentence(saved, spoil, part):
    path = saved[0] / "model.json"
    path.write_text(spoil(path.read_text()))
    with pytest.raises(InputError) as caught:
        load(saved[0])
    assert part in str(caught.value) and "\n" not in str(caught.value)


def test_another_file_of_a_result_is_meant_as_its_folder(saved):
    """`result.json` beside `model.json`, say; alone it is refused."""
    folder = saved[0]
    (folder / "result.json").write_text("{}")
    np.testing.assert_array_equal(load(folder / "result.json").u, load(folder).u)
    (folder / "model.json").unlink()
    with pytest.raises(InputError):
        load(folder / "result.json")


class Paired(AbstractModel):
    """Its choices only go together."""

    form: str = eqx.field(static=True, default="a")
    size: int = eqx.field(static=True, default=1)
    family: ClassVar[str] = "impact"
    provides: ClassVar[tuple[str, ...]] = ()

    def __check_init__(self):
        if (self.form, self.size) not in (("a", 1), ("b", 2)):
            raise ValueError("they do not go together")

    def extend(self, effects):
        raise NotImplementedError


def test_choices_are_put_in_together():
    made = _choose(Paired(), {"form": "b", "size": 2}, Path("model.json"))
    assert isinstance(made, Paired) and (made.form, made.size) == ("b", 2)
    with pytest.raises(InputError, match="do not go together"):
        _choose(Paired(), {"form": "b", "size": 1}, Path("model.json"))


def test_a_folder_without_a_model_is_refused(campaign, tmp_path):
    with pytest.raises(InputError, match="model.json"):
        load(tmp_path)
    with pytest.raises(InputError, match="model.json"):
        resolve_model(str(tmp_path))
    (tmp_path / "file").write_text("")
    space = ParameterSpace(Ball(), ())
    with pytest.raises(InputError):
        save_model(tmp_path / "file" / "m", make_fitted(
            campaign=campaign, model_name="paper", space=space, solution=make_solution(space, ["restitution"], {}),
            noise={}, effects=()))
