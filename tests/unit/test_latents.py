from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.scene import Entity, LatentDeclaration
from bsp_gp.data.tables import load_dataset, save_dataset
from bsp_gp.errors import DataError
from bsp_gp.inference.latents import Latents, declared_latents, latents_of
from bsp_gp.inference.priors import Prior
from tests.latent_worlds import MASSES, dataset, masses_of, scenes


def test_every_row_has_its_own_latent_and_truth_is_kept_for_scoring():
    some = scenes(2)
    latents = masses_of(some)
    assert latents.names == ("mass[s0:b1]", "mass[s0:b2]", "mass[s1:b1]", "mass[s1:b2]")
    assert latents.truth == pytest.approx([e.mass for s in some for e in s.entities[1:]])
    assert latents.columns == ("mass",)


def test_one_body_in_several_scenes_has_one_value():
    ball = Entity("ball", properties={"mass": 2.0})
    one, two = (replace(s, entities=(s.entities[0], ball, s.entities[2])) for s in scenes(2))
    latents = latents_of((one, two), "mass", MASSES, entities=["ball"])
    assert latents.names == ("mass[ball]",)
    assert latents.items[0].members == (("s0", "ball"), ("s1", "ball"))
    filled = latents.filled((one, two), [3.5])
    assert [s.entities[1].mass for s in filled] == [3.5, 3.5]
    assert one.entities[1].mass == 2.0


def test_sharing_by_all_and_by_a_column():
    some = scenes(2)
    assert latents_of(some, "mass", MASSES, share="all").names == ("mass",)
    coloured = tuple(
        replace(
            s,
            entities=tuple(
                Entity(e.name, properties={**e.properties, "color": float(k % 2)})
                for k, e in enumerate(s.entities)
            ),
        )
        for s in some
    )
    latents = latents_of(coloured, "mass", MASSES, share="color")
    assert latents.names == ("mass[color=0]", "mass[color=1]")
    with pytest.raises(DataError, match="no value"):
        latents_of(some, "mass", MASSES, share="color")


def test_blocks_are_scenes_that_share_nothing():
    some = scenes(3)
    own = masses_of(some)
    names = [s.name for s in some]
    assert [list(index) for _, index in own.blocks(names)] == [[0, 1], [2, 3], [4, 5]]
    shared = latents_of(some, "mass", MASSES, share="all")
    assert [group for group, _ in shared.blocks(names)] == [("s0", "s1", "s2")]


def test_those_without_a_value_are_meant_by_default():
    some = scenes(1)
    blank = replace(
        some[0],
        entities=(some[0].entities[0], Entity("b1"), some[0].entities[2]),
    )
    assert latents_of((blank,), "mass", MASSES).names == ("mass[s0:b1]",)
    with pytest.raises(DataError, match="concerns no entity"):
        latents_of(some, "mass", MASSES, entities=["nobody"])


def test_declared_latents_survive_the_round_trip_of_a_folder(tmp_path):
    declared = (
        LatentDeclaration("mass", low=0.2, high=9.0, entities=("b1", "b2")),
        LatentDeclaration("friction", prior="truncated_normal", mean=1.0, sd=0.5, low=0.1),
    )
    folder = save_dataset(dataset(2, declared), tmp_path / "data")
    latents = declared_latents(load_dataset(folder))
    masses = [item for item in latents.items if item.column == "mass"]
    assert len(masses) == 4
    assert masses[0].prior == Prior("uniform", 0.2, 9.0)
    friction = next(item for item in latents.items if item.column == "friction")
    assert (friction.prior.mean, friction.prior.sd, friction.prior.low) == (1.0, 0.5, 0.1)


def test_prior_of_all_is_the_sum_and_coordinates_round_trip():
    some = scenes(1)
    latents = Latents(
        (
            *masses_of(some).items,
            *latents_of(some, "friction", Prior("log_uniform", 0.1, 10.0)).items,
        )
    )
    values = latents.sample(50, rng=np.random.default_rng(0))
    each = [item.prior.log_prob(values[:, k]) for k, item in enumerate(latents.items)]
    assert latents.log_prior(values) == pytest.approx(np.sum(each, axis=0))
    assert latents.from_coordinate(latents.to_coordinate(values)) == pytest.approx(values)
    coordinates = latents.to_coordinate(values)
    # In its coordinate a log-uniform prior is flat.
    flat = latents.log_prior(values) + latents.log_jacobian(coordinates)
    assert np.ptp(flat) < 1e-9
