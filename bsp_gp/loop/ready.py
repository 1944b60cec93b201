"""A data set as the fits of a run take it: declared, split, with its noise."""

from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np

from bsp_gp.data.flat import held_flat
from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.split import choose_split
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.followed import about_ends, about_lost, followed
from bsp_gp.fitting.hypothesis import Hypothesis, TrackNoise, read_law
from bsp_gp.fitting.law_fit import about_outliers, training_part, unset
from bsp_gp.fitting.parts.latents import unknown_properties
from bsp_gp.fitting.parts.rails import rail_of
from bsp_gp.fitting.rests import without_rests
from bsp_gp.inference.latents import declared_latents
from bsp_gp.language.inputs import DIRECTIONS, STATE_INPUTS
from bsp_gp.language.operators import is_across_in
from bsp_gp.language.render import to_text
from bsp_gp.loop.kinked import bounce
from bsp_gp.loop.proposal import FAULTS, continued
from bsp_gp.physics.aliasing import aliasing_notes
from bsp_gp.physics.bodies import dataset_types, input_types_of, stack
from bsp_gp.physics.force import ForceLaw
from bsp_gp.physics.masses import check_properties, with_usable_masses


class Ready:
    """A data set as fits take it.

    Parameters
    ----------
    dataset : Dataset
    declared : str, sequence of str, or ForceLaw
    rng : numpy.random.Generator
        For what is held out.
    all_rows : bool
        Whether rows at which bodies are held stay.

    Attributes
    ----------
    dataset : Dataset
        All scenes.
    law : ForceLaw
        The declared one.
    split : Split
    train : Dataset
        What is learned from.
    before_cut : Dataset or None
        Of scenes that are cut in time, what comes before the cut.
    hypothesis : Hypothesis
        The declared one, with the properties that are unknown; tracks that no path under the
        declared law follows are cut short in it.
    far_off : tuple
        Rows in it that are far off their neighbours.
    noise : NoiseEstimate
    is_swapped : bool
        Whether train and test were swapped.
    """

    is_swapped = False

    def __init__(self, dataset, declared, rng, all_rows=False):
        latents = declared_latents(dataset) if dataset.latents else None
        if latents is not None:
            everywhere = unknown_properties(dataset, latents, dataset.scenes)
            dataset = replace(everywhere.seen(dataset), latents=())
        declared = (declared,) if isinstance(declared, str) else declared
        is_law = isinstance(declared, ForceLaw)
        self.law = unset(declared) if is_law else read_law(dataset, declared)
        if latents is None and not all_rows:
            dataset = without_rests(dataset, self.law)
        self.dataset = held_flat(with_usable_masses(dataset), _spoken(self.law, dataset))
        self.noise = estimate_noise(self.dataset)
        self.rail = None if self.law.frame or self.law.unseen else rail_of(
            self.dataset, self.noise.inactive_axes
        )
        self.latents = latents
        self._learn_from(choose_split(self.dataset, rng))

    @cached_property
    def bounces(self):
        """Whether bodies turn back at walls; of long recordings it takes seconds to tell."""
        return not self.dataset.is_of_sight and bounce(self.dataset)

    def _learn_from(self, split):
        self.split, self._refitted = split, {}
        self.train, self.far_off = training_part(self.dataset, split.learned, self.noise)
        self.is_weeded = self.train.scenes is not split.learned
        self.before_cut = None
        if split.whole and split.test:
            self.before_cut, _ = training_part(self.dataset, split.train, self.noise)
        check_properties(stack(self.train.scenes, self.dataset.up), self.law)
        self.hypothesis = self._declared(self.train)

    def _declared(self, train):
        hypothesis = Hypothesis.from_laws(train, self.law)
        if self.rail is not None:
            hypothesis += self.rail
        if self.latents is not None:
            hypothesis += unknown_properties(self.dataset, self.latents, train.scenes)
        return hypothesis

    @property
    def has_more(self):
        """Whether scenes are held out that are not learned from."""
        return bool(self.split.test) and self.before_cut is None

    def everything(self):
        """All scenes as fits take them."""
        scenes = (*self.split.learned, *self.split.test)
        return training_part(self.dataset, scenes, self.noise)[0]

    def swapped(self, noise):
        """The same with train and test swapped; a memory of the noise that was told is known there.

        Few scenes tell little of it, and what it does there would pass for a force.
        """
        other = copy(self)
        other.is_swapped = True
        other._learn_from(self.split.swapped)
        model = other.hypothesis.noise
        if noise.correlated and model.is_free.any() and not model.is_correlation_known:
            model = replace(
                model, correlated=noise.correlated, correlation_time=noise.correlation_time,
                is_correlation_known=True,
            )  # fmt: skip
            other.hypothesis += TrackNoise(model)
        return other

    def begin(self, starts, bounds, clock):
        """The fit of what is declared, to tracks as far as it can follow them."""
        found, self.hypothesis = followed(
            self.hypothesis, self.train, starts=starts, bounds=bounds, deadline=clock.left
        )
        return found

    def refitted(self, found, hypothesis, bounds, clock):
        """A fit as it would be without the rows that are held out.

        Only where rows of scenes are held out has it seen any of them. It begins at the fit, where
        these were the last, and ends where the rows that are left lead; one that cannot be fitted
        to these foresees nothing.
        """
        if self.before_cut is None:
            return found
        if found not in self._refitted:
            self._refitted[found] = self._without_held_out(found, hypothesis, bounds, clock)
        return self._refitted[found]

    def _without_held_out(self, found, hypothesis, bounds, clock):
        nothing = replace(found, status="nonfinite", values=np.full(len(found.values), np.nan))
        hypothesis = continued(hypothesis, found)
        if found.is_failed or not _shows_motion(hypothesis.seen(self.before_cut).scenes):
            return nothing
        try:
            return fit(
                hypothesis, self.before_cut, bounds=hypothesis.own(bounds), deadline=clock.left,
                near=_cut(found, hypothesis.seen(self.before_cut).scenes),
            )
        except FAULTS:
            return nothing

    def notes(self, found, hypothesis):
        """What is known of the data beside a hypothesis that was fitted to them."""
        return (
            *self.noise.notes, *about_lost(hypothesis), *about_ends(hypothesis, self.train),
            *about_outliers(found, self.is_weeded, self.far_off, self.dataset.units),
            *aliasing_notes(found.law, self.train.scenes, self.dataset.units),
        )  # fmt: skip


def _spoken(law, dataset):
    """Axes of which a law speaks; all where it has constraints or frames, or the data vectors.

    Products across are no vectors in a plane.
    """
    types, axes = dataset_types(dataset) | input_types_of(dataset), set()
    vectors = [n for n in types if n not in STATE_INPUTS and types[n].shape == "vector"]
    is_across = not all(is_across_in(to_text(term.formula), 2) for term in law.terms)
    if law.frame or law.unseen or vectors or is_across:
        return set("xyz"[: dataset.n_dims])
    for name in {name for term in law.terms for name in term.formula.inputs} & {*DIRECTIONS}:
        axes.add(dataset.up.strip("-") if name in ("up", "down") else name[-1])
    return axes


def _cut(found, scenes):
    """A fit at the rows of scenes that end before its own, as where another begins; or None."""
    times, nodes = {scene.name: scene.times for scene in scenes}, []
    for chains, states in zip(found.groups, found.nodes, strict=True):
        own = [times.get(name, np.zeros(0)) for name in chains.scenes]
        kept = np.zeros((*states.shape[:3], max(map(len, own)), states.shape[4]))
        for s, rows in enumerate(own):
            n = min(len(rows), int(chains.lengths[s]))  # some are cut short
            if not n or not np.array_equal(chains.times[:n, s], rows[:n]):
                return None
            kept[..., :n, s] = states[..., :n, s]
        nodes.append(kept)
    return replace(found, nodes=tuple(nodes))


def _shows_motion(scenes):
    """Whether every body that forces move is seen at least twice in every scene."""
    seen = (np.isfinite(s.positions[:, s.dynamic]).all(axis=-1).sum(axis=0) for s in scenes)
    return all((count >= 2).all() for count in seen)
