"""Looks at a data set, and which of them counts."""

import time
from dataclasses import dataclass, field, replace

from bsp_gp.data.parts import part_of, rows_of
from bsp_gp.errors import DataError
from bsp_gp.fitting.hands import without_hands
from bsp_gp.fitting.rests import without_still_ends
from bsp_gp.loop.carried import carried
from bsp_gp.loop.foresight import Foresight, that_foresee
from bsp_gp.loop.kept import rounds_from
from bsp_gp.loop.kinked import bounce_oddly, in_flights, in_parts, is_astray, lacks
from bsp_gp.loop.loop import run_rounds
from bsp_gp.loop.proposers.kicks import is_kicked
from bsp_gp.loop.ready import Ready
from bsp_gp.loop.retraced import is_likelier, retraced

AGAIN = 0.5
"""Part of the time for a part of the rows that all take, a row, with what was found there."""
FIRST_LOOK = 0.6
"""Part of the time for a first look at bodies that bounce, behind which flights are followed."""


@dataclass(frozen=True, eq=False)
class Look:
    """What came of looking at a data set.

    Attributes
    ----------
    ready : Ready
    begun : Fit
        Of what is declared.
    rounds : list of Round
    foresight : Foresight or None
        What its causes do to predictions of held-out scenes; None where that was not asked.
    foreseen : dict
        Predictions that were made for it.
    is_cut : bool
        Whether a look at what was held out was cut by the time limit.
    is_all : bool
        Whether all rows were looked at.
    """

    ready: Ready
    begun: object
    rounds: list
    foresight: object = None
    foreseen: dict = field(default_factory=dict)
    is_cut: bool = False
    is_all: bool = True

    @property
    def shows_something(self):
        """Whether its first round says that something is missing."""
        return self.rounds[0].decision.verdict not in ("nothing missing", "cannot tell")


class Looks:
    """Looks at a data set: at a part of its rows, at all, at flights, from laws of textbooks.

    Parameters
    ----------
    declared : object
        Laws, as `Ready` takes them.
    proposers : callable
        ``proposers(train)``: whom a look at training scenes asks.
    clock, until : Clock
        The first ends rounds, the second what must be fitted for their predictions.
    starts, bounds : dict or None
        Of the constants of what is declared.
    all_rows : bool
        Whether data are taken as they are.
    progress : callable
    settings : dict
        Of `run_rounds`: criteria, max_rounds, crew, is_enough.
    """

    def __init__(
        self, declared, proposers, *, clock, until, starts, bounds, all_rows, progress, settings
    ):  # fmt: skip
        self.declared, self.proposers = declared, proposers
        self.clock, self.until, self.all_rows, self.says = clock, until, all_rows, progress
        self.starts, self.bounds, self.settings = starts, bounds, settings
        self.how = starts, bounds, clock  # what is declared is fitted

    def found(self, ready, streams, earlier=None, on_round=None):
        """What is found in a data set.

        Parameters
        ----------
        ready : Ready
        streams : mapping of str to numpy.random.Generator
            For ``rounds, foresight, swapped, parts, flights, retraced, few``.
        earlier : str, optional
            Rounds of a run before, see `bsp_gp.loop.kept`.
        on_round : callable, optional

        Returns
        -------
        Look
        """
        look, needed = None, 0.0
        if earlier is None and not self.all_rows:
            look, needed = self._at_a_part(ready, streams["few"])
        # A part tells of all where time for all is lacking.
        is_all = look is None or self.clock.left is None or self.clock.left > needed
        if is_all:
            look = self._at_all(ready, look, streams, earlier, on_round)
        look = self._from_usual_laws(look, streams["retraced"])
        look = self._at_held_out(look, streams["swapped"])
        if not look.ready.is_swapped:  # what acts in those scenes only foresees nothing of others
            look = replace(look, rounds=that_foresee(look.rounds, look.foresight))
        return replace(look, is_all=is_all)

    def _rounds(self, ready, rng, begun, clock=None, **more):
        return run_rounds(
            ready.hypothesis, ready.train, self.proposers(ready.train), rng=rng, begun=begun,
            clock=clock or self.clock, starts=self.starts, bounds=self.bounds, progress=self.says,
            looks=2 if ready.has_more else 1, **self.settings, **more,
        )  # fmt: skip

    def _first(self, ready, rng, begun, rng_ahead, **more):
        """A look whose causes must foresee what is held out."""
        foreseen: dict = {}
        ahead = Foresight(
            lambda found, hypothesis: ready.refitted(found, hypothesis, self.bounds, self.until),
            ready.dataset, ready.split.test, rng_ahead.spawn(self.settings["max_rounds"]),
            self.settings["crew"], foreseen,
        )  # fmt: skip
        more |= {"is_refused": ahead.refuses, "instead": ahead.instead}
        return Look(ready, begun, self._rounds(ready, rng, begun, **more), ahead, foreseen)

    def _begin(self, ready, rng, is_cut):
        """The data with the fit of what is declared, without hands, cut where velocities jump."""
        begun = ready.begin(*self.how)
        if is_cut:
            return ready, begun
        return _in_parts(ready, begun, self.declared, rng, self.how, self.settings["criteria"])

    def _at_a_part(self, ready, rng):
        """A look at a part of many rows, and seconds that all would take after it; or None."""
        begin_rng, look_rng, ahead_rng = rng.spawn(3)
        small = _part_of(ready, self.declared, begin_rng)
        if small is None:
            return None, 0.0
        self.says("looking at a part of the rows")
        since = time.monotonic()
        is_cut = any(scene.part_of for scene in small.dataset.scenes)  # no hand throws a window
        small, begun = self._begin(small, begin_rng, is_cut)
        look = self._first(small, look_rng, begun, ahead_rng)
        times = rows_of(ready.train.scenes) / rows_of(small.train.scenes)
        return look, AGAIN * times * (time.monotonic() - since)

    def _at_all(self, ready, part, streams, earlier, on_round):
        """A look at all rows, with what was found in a part or a run before."""
        self.says("fitting the declared model")
        ready, begun = self._begin(ready, streams["parts"], self.all_rows)
        own = {"bounds": self.bounds, "criteria": self.settings["criteria"]}
        data = ready.hypothesis, ready.train, begun
        if earlier is not None:
            earlier = rounds_from(earlier, *data, **own)
        elif part is not None:
            self.says("fitting what was found in a part to all rows")
            earlier = carried(part.rounds, *data, clock=self.clock, **own)
            for done in earlier if on_round is not None else ():
                on_round(done)
        # Where a body bounces it may have to be followed anew, from wall to wall.
        may_fly = not self.all_rows and lacks(begun, ready.noise.sigma) and ready.bounces
        flights = in_flights(ready.dataset) if may_fly else None
        look = self._first(
            ready, streams["rounds"], begun, streams["foresight"], on_round=on_round,
            earlier=earlier, clock=None if flights is None else self.clock.share(FIRST_LOOK),
        )  # fmt: skip
        is_asked = flights is not None and not self.clock.is_over
        if is_asked and _asks_flights(look.rounds, ready.noise.sigma):
            look = self._at_flights(look, flights, streams["flights"])
        return look

    def _at_flights(self, look, flights, rng):
        """The same at flights from wall to wall, where that adopts something."""
        self.says("following flights from wall to wall")
        ready, (look_rng, ahead_rng) = Ready(flights, self.declared, rng), rng.spawn(2)
        other = self._first(ready, look_rng, ready.begin(*self.how), ahead_rng)
        return other if any(done.decision.is_adopted for done in other.rounds) else look

    def _from_usual_laws(self, look, rng):
        """The same from laws of textbooks on, where that leads to what is likelier."""
        before = retraced(look.rounds)
        if before is None or self.clock.is_over:
            return look
        self.says("asking for more beside laws of textbooks")
        look_rng, ahead_rng = rng.spawn(2)
        other = self._first(look.ready, look_rng, look.begun, ahead_rng, earlier=before)
        is_better = is_likelier(other.rounds, look.rounds, self.settings["criteria"])
        return other if is_better else look

    def _at_held_out(self, look, rng):
        """A look at what was held out: what acts there only would be missed."""
        if not (look.ready.has_more and look.rounds[0].decision.verdict == "nothing missing"):
            return look
        self.says("looking at what was held out")
        other = look.ready.swapped(look.rounds[0].entering.noise)
        begun = other.begin(*self.how)
        rounds = self._rounds(other, rng, begun)
        is_cut, held_out = bool(rounds[0].left_out), Look(other, begun, rounds)
        if held_out.shows_something:
            return replace(held_out, foreseen=look.foreseen, is_cut=is_cut)
        return replace(look, is_cut=is_cut)


def _part_of(ready, declared, rng):
    """A part of the rows of a large data set as fits take it; None where all are looked at at once.

    Nor is one taken of bodies that bounce, which are followed from wall to wall, or where nothing
    moves in it.
    """
    few = part_of(ready.dataset)
    if few is None or ready.bounces:
        return None
    try:
        return Ready(few, declared, rng)
    except DataError:
        return None


def _asks_flights(rounds, levels):
    """Whether no wall was adopted, and something is left, or rows are far off what is foreseen."""
    found = [done.decision.best for done in rounds if done.decision.is_adopted]
    if any(row.kind == "wall" for row in found):
        return False
    is_left = rounds[-1].decision.verdict != "nothing missing"
    return is_left or is_astray(rounds[-1].after, levels)


def _in_parts(ready, begun, declared, rng, how, criteria):
    """The data set and its first fit, without hands at the ends of recordings, these cut in parts.

    Bodies that bounce as no wall foretells are followed from flight to flight, with no hands.

    Where velocities jump, and not where that leaves nothing: then kicks are all that is missing,
    and are found as such. What is kicked at random is taken whole.
    """
    def anew(dataset):
        made = Ready(dataset, declared, rng)
        return made, made.begin(*how)

    whole = ready, begun
    if ready.dataset.is_of_sight or not lacks(begun, ready.noise.sigma):
        return whole
    bounces = ready.bounces
    # What nothing moves may rest for as long as it likes: no law says that it is held.
    dataset = without_still_ends(ready.dataset) if bounces or not ready.law.terms else None
    if dataset is not None and dataset is not ready.dataset:
        ready, begun = whole = anew(dataset)
    if bounces:
        flights = in_flights(ready.dataset) if bounce_oddly(ready.dataset) else None
        return whole if flights is None else anew(flights)
    dataset = without_hands(ready.dataset, ready.law)
    if dataset is not None:
        ready, begun = anew(dataset)
    still_lacks = dataset is None or lacks(begun, ready.noise.sigma)
    dataset = in_parts(ready.dataset, begun) if still_lacks else None
    if dataset is not None:
        other, found = anew(dataset)
        if lacks(found, other.noise.sigma):
            ready, begun = other, found
    if ready is not whole[0] and is_kicked(whole[0].dataset, whole[1], criteria):
        return whole
    return ready, begun
