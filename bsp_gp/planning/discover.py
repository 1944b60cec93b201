"""The loop closed by the next measurement: plan, run, find what is missing, until a law stands.

What a law is found from first are the *calm* rows of every experiment, those before forces have
led a body off by a good part of its distance to the next one: a few rows show where it was there.
Then the law is fitted to whole recordings, asked what it lacks, and its rivals are weighed on all
that was seen. Experiments are chosen by what they promise to tell the rivals apart.
"""

import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from bsp_gp.errors import DataError, LawError, SettingsError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.language.formula import factors
from bsp_gp.language.render import to_text
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.evidence import log_evidence
from bsp_gp.loop.outcome import law_record
from bsp_gp.output.place import whole_file
from bsp_gp.physics.engine.owners import fitted_properties
from bsp_gp.physics.force import ForceLaw, split_linear
from bsp_gp.physics.masses import with_unit_masses, with_usable_masses
from bsp_gp.planning.apparatus import Recording, Refused, recording_of
from bsp_gp.planning.ends import at_the_ends
from bsp_gp.planning.means import Experiment
from bsp_gp.planning.plan import N_DRAWS, SURE, moved_by, plan
from bsp_gp.planning.reach import n_calm, n_foreseen, nearest
from bsp_gp.planning.rivals import (
    Rival,
    in_common,
    kin_of,
    less_a_term,
    of_whole_powers,
    rivals_of,
)
from bsp_gp.randomness import generator

LEAST_ROWS = 4
MOST_REFUSED = 8
"""Experiments of a round in place of which another is made where the apparatus refuses them."""
ENOUGH = 2
"""Experiments for every number that may be chosen before a law is looked for."""
FEW = 0.5
"""Shorter experiments are made where fewer of the rows are calm."""
SEEN = 8.0
"""Standard deviations by which forces should lead a body off for them to be seen at all."""
CLEARLY = 4 * SEEN
"""The same from which experiments of half the time, in which a quarter of it is left, show them."""
PATIENCE = 3
"""Rounds after which whole recordings that no law of calm rows fits are asked what is missing."""
PATIENT = 8
"""Times the usual effort of a fit that rivals may take on all recordings, while none fits."""
MOST_ALONG = 2
"""Terms of a law that stands along one direction, such as that to another body."""
MOST_CAUSES = 4
"""Causes that one closing of the loop may add."""
FITS = 1.5
"""Reduced chi-squared up to which a law of known noise fits."""
LEAST_LIKELY = 1e-4
"""Rivals that are less likely beside one that fits are not weighed again."""


@dataclass(frozen=True, eq=False)
class Discovery:
    """What was found out.

    Attributes
    ----------
    law : ForceLaw or None
        The likeliest, with its constants; ``law.simulate`` predicts.
    posterior : tuple of Rival
        What may be true, the likeliest first, weighed on all recordings.
    stands : bool
        Whether the law is sure, fits, and nothing is missing beside it.
    open : tuple of str
        Codes of what is not settled: "no_law", "rivals", "misfit", "missing", "series" (so many
        terms act along one direction that they may stand for another form), "unforeseen" (it has
        not foreseen a round of experiments yet), "untried" (nor one at the ends of the means),
        "inseparable".
    inseparable : tuple of (str, str)
        Rivals that no experiment within the means parts.
    dataset : Dataset or None
    report : LoopReport or None
        Of the last closing of the loop.
    """

    law: ForceLaw | None
    posterior: tuple
    stands: bool
    open: tuple
    inseparable: tuple
    rounds: int
    experiments: tuple = field(repr=False)
    recordings: tuple = field(repr=False)
    dataset: object = field(repr=False, default=None)
    report: object = field(repr=False, default=None)

    def __repr__(self):
        told = "none" if self.law is None else self.law.text()
        lines = [f"Discovery after {self.rounds} round(s), {len(self.experiments)} experiments",
                 f"  law: F_i = {told}{' (stands)' if self.stands else ''}"]  # fmt: skip
        lines += [f"  {r.probability:.3f}  {r.text}" for r in self.posterior[:5]]
        return "\n".join([*lines, f"  open: {', '.join(self.open) or 'nothing'}"])

    def to_dict(self):
        """For a file: JSON with plain numbers."""
        return {
            "law": None if self.law is None else {"text": self.law.text(), **law_record(self.law)},
            "posterior": [{"law": r.text, "probability": r.probability} for r in self.posterior],
            "stands": self.stands, "open": list(self.open), "rounds": self.rounds,
            "inseparable": [list(pair) for pair in self.inseparable],
        }  # fmt: skip


def discover(
    run, means, rounds=16, *, rng=None, declared=(), out=None, grammar="physics", time_limit=None,
    progress=None,
):  # fmt: skip
    """Find a law by experiments of one's own.

    Parameters
    ----------
    run : callable
        ``run(experiment) -> recording``: an `Experiment` in; a `Recording`, or a mapping with
        ``rows`` of (entity, t, x, y[, z]) and maybe ``sigma``, out.
    means : Means
    rounds : int
        At the most.
    rng : numpy.random.Generator, int or None
    declared : str or sequence of str
        Laws that are believed beforehand.
    out : path-like, optional
        Folder in which every round is kept; one that is there is gone on from.
    grammar : str, path or Grammar
    time_limit : float, optional
        Seconds of every closing of the loop.
    progress : callable, optional
        ``progress(text)``.

    Returns
    -------
    Discovery
    """
    if rounds < 1:
        raise SettingsError(f"rounds must be at least 1, got {rounds!r}")
    settings = {
        "grammar": grammar, "criteria": Criteria(), "max_rounds": MOST_CAUSES,
        "time_limit": time_limit, "n_bootstrap": 0,
    }  # fmt: skip
    state = _State(means, (declared,) if isinstance(declared, str) else tuple(declared), settings,
                   progress or (lambda text: None), out)  # fmt: skip
    streams = generator(rng).spawn(rounds)
    number = state.resume()
    for stream in () if state.stands else streams[number:]:
        number += 1
        plan_rng, loop_rng = stream.spawn(2)
        chosen = state.next(plan_rng)
        if not chosen:
            number -= 1
            break
        state.says(f"round {number}: {len(chosen)} experiment(s)")
        state.make(run, chosen, plan_rng)
        state.learn(loop_rng, is_last=number == rounds)
        state.keep(number)
        if state.stands:
            break
    return state.result(number)


class _State:
    """What is known so far."""

    def __init__(self, means, declared, settings, says, out):
        self.means, self.declared, self.settings, self.says = means, declared, settings, says
        self.out = None if out is None else Path(out)
        self.experiments, self.recordings = [], []
        self.rivals = ()
        self.report, self.stands, self.left, self.inseparable = None, False, ("no_law",), ()
        self.part, self.is_misfit, self.n_misfits = 1.0, False, 0
        self.n_lost = 0  # rounds since a law was found that fits
        self.longest = 1.0  # part of the time of which enough rows are calm
        self.is_foretold = False  # whether the law foresaw the experiments of this round
        self.is_at_ends = False  # whether experiments were made at the ends of the means

    # --- what is tried ---------------------------------------------------------------------------

    def next(self, rng):
        """The experiments of the next round; none where no experiment would tell anything."""
        count = self.means.at_once
        if self.left == ("untried",):
            self.is_at_ends = True
            chosen = at_the_ends(self.means, self.experiments, rng, max(count, 1))
            if chosen:
                return chosen
        if self.rivals and not self.is_misfit:
            found = plan(self.rivals, self.means, rng=rng, n_told=max(count, 1))
            self.inseparable = found.inseparable
            if found.is_worth_it:
                return [o.experiment for o in found.options[:count]]
            if self.left == ("rivals",):
                return []
        # What is short may be calm beside what nobody sees; what changes with time takes long.
        parts = (self.part, self.longest if self.n_lost else self.part)
        return [self.means.draw(rng, parts[k % 2]) for k in range(count)]

    def make(self, run, chosen, rng):
        """Make experiments; in place of those that the apparatus refuses others by chance."""
        queue, made, refused = list(chosen), 0, []
        while queue:
            experiment = queue.pop(0)
            try:
                recording = recording_of(run(experiment), experiment)
            except Refused as error:
                refused.append(error)
                self.says(f"refused: {error}")
                if len(refused) <= MOST_REFUSED:
                    queue.append(self.means.draw(rng, self.part))
                continue
            self.add(experiment, recording)
            made += 1
        if not made:
            raise refused[-1]

    def add(self, experiment, recording):
        """Remember what was seen."""
        self.experiments.append(experiment)
        self.recordings.append(recording)

    # --- what is learned -------------------------------------------------------------------------

    def scenes(self):
        """All recordings."""
        return [
            _scene(f"experiment {k}", e, r, self.means)
            for k, (e, r) in enumerate(zip(self.experiments, self.recordings, strict=True), 1)
        ]

    @property
    def dataset(self):
        return self.means.dataset(self.scenes())

    def learn(self, rng, is_last=False):
        """Weigh the rivals on everything, and close the loop where they do not do.

        Too few experiments are no reason to believe anything, unless there will be no more.
        """
        if len(self.experiments) < ENOUGH * self.means.n_choices and not is_last:
            return
        calm_rng, whole_rng, cut_rng = rng.spawn(3)
        scenes = self.scenes()
        calm_scenes = [calm(s) for s in scenes]
        self._choose_part(scenes, calm_scenes)
        if self.n_lost % 2:
            calm_scenes = [self._short(s) for s in calm_scenes]
        calm_scenes = [s for s in calm_scenes if len(s.times) >= LEAST_ROWS] or scenes
        self.is_foretold, whole = False, self.means.dataset(scenes)
        if self.rivals:
            best = self.rivals[0].text
            whole = self._foreseeable(scenes, cut_rng)
            self._weigh(whole)
            self.is_foretold = not self.is_misfit and self.rivals[0].text == best
        if not self.rivals or self.is_misfit or "series" in self.left:
            base = self._from_calm(self.means.dataset(calm_scenes), calm_rng)
            self.says(f"found: {base.text()}")
            if self.rivals:
                self._weigh(self.means.dataset(calm_scenes))
                whole = self._foreseeable(scenes, cut_rng)
                self._weigh(whole)
        self._judge()
        if not self.left and not self.is_foretold:
            self.left = ("unforeseen",)
        elif not self.left and not self.is_at_ends and not is_last:
            self.left = ("untried",)
        self.n_misfits = self.n_misfits + 1 if self.is_misfit else 0
        self.n_lost = self.n_lost + 1 if self.is_misfit or not self.rivals else 0
        is_asked = self.is_foretold or is_last
        if self.left in ((), ("unforeseen",)) and is_asked or self.n_misfits >= PATIENCE:
            self._ask_whole(whole, whole_rng)

    def _foreseeable(self, scenes, rng):
        """Recordings up to where the likeliest law no longer foresees where bodies are.

        After a close pass what is unknown of a constant leads to anywhere: such rows tell little,
        and a descent is lost among them. The better constants are known, the more rows there are.
        Calm rows stay whatever is known: a law of vague constants must not choose what it is
        tried on, or one that says little fits and stands.
        """
        best = self.rivals[0]
        draws = best.draws(rng, N_DRAWS)
        cut = []
        for scene in scenes:
            track = moved_by(best.law, draws, [with_unit_masses(scene)], self.means, rng)[:, :, 0]
            near = nearest(scene.positions, scene.dynamic)
            count = max(n_foreseen(track, near), len(calm(scene).times))
            if count >= LEAST_ROWS:
                cut.append(scene if count == len(scene.times) else scene.rows(None, count))
        return self.means.dataset(cut or scenes)

    def _choose_part(self, scenes, calm_scenes):
        """Shorter experiments where forces lead bodies far off, longer where they hardly do.

        Where no law is found, what leads them off may be something that nobody sees, and rows of
        which nothing tells that they are not calm are left out as well.
        """
        kept = sum(len(s.times) for s in calm_scenes) / sum(len(s.times) for s in scenes)
        near = map(self._short, scenes) if self.n_lost else scenes
        shown = np.median([_departure(s)[-1] / max(self._noise(s), 1e-300) for s in near])
        if kept < FEW or (self.n_lost and shown > CLEARLY):
            self.part = max(self.part / 2, 1e-3)
            self.longest = self.part if kept < FEW else self.longest
        elif shown < SEEN:
            self.part = min(self.part * 2, 1.0)
            self.longest = max(self.longest, self.part)

    def _short(self, scene):
        """The rows of a scene that an experiment as short as the next ones has."""
        count = np.searchsorted(scene.times, scene.times[0] + self.part * self.means.longest,
                                side="right")  # fmt: skip
        return scene if count >= len(scene.times) else scene.rows(None, max(int(count), 3))

    def _noise(self, scene):
        return float(np.median(self.means.sigma(scene.positions[:, scene.dynamic])))

    def _from_calm(self, dataset, rng):
        """Close the loop on calm rows; the law that it ends with."""
        self.says("closing the loop on calm rows")
        self.report = close_loop(
            dataset, self.declared, rng=rng, progress=self.says, **self.settings
        )
        self._take(self.report)
        return self.report.law

    def _take(self, report):
        """The rivals of a report, and its law with what every round has found."""
        found = list(rivals_of(report))
        text = report.law.text(digits=False)
        is_told = not fitted_properties(report.law)  # of bodies that are known alone
        known = any(r.law.text(digits=False) == text for r in found)
        if report.law.terms and is_told and not known:
            found = [_final(report), *found]
        found = [r for r in found if r.law.terms]
        kin = []
        if found:
            seen = with_usable_masses(self.dataset)
            kin = [*kin_of(found[0], seen), *of_whole_powers(found[0], seen)]
        less = [one for rival in (*found[:1], *kin) for one in less_a_term(rival)]
        rivals: dict = {}
        for rival in (*found, *kin, *less):
            rivals.setdefault(rival.law.text(digits=False), rival)
        self.rivals = tuple(rivals.values())

    def _weigh(self, dataset):
        """Fit every rival to all recordings; those that cannot be fitted are left out.

        The better a power is known, the more it says which whole one it may be.
        """
        kept, heights, reduced, criteria = [], [], [], self.settings["criteria"]
        dataset = with_usable_masses(dataset)
        texts = {rival.text for rival in self.rivals}
        whole = of_whole_powers(self.rivals[0], dataset) if self.rivals else ()
        self.rivals = (*self.rivals, *(rival for rival in whole if rival.text not in texts))
        for rival in self.rivals:
            self.says(f"fitting {rival.text}")
            hypothesis = Hypothesis.from_laws(dataset, rival.law)
            is_fitted = self._is_known and min(reduced, default=math.inf) < FITS
            effort = (1 if is_fitted else PATIENT) * criteria.effort
            found = fit(hypothesis, dataset, effort=effort)
            height = log_evidence(found, hypothesis, criteria)
            height -= criteria.cause_nats * len(rival.law.terms)
            if not math.isfinite(height):
                continue
            kept.append(_fitted(rival, found))
            heights.append(height)
            reduced.append(found.chi2_red)
        self.is_misfit = not kept
        if not kept:
            return
        weights = np.exp(np.array(heights) - max(heights))
        order = np.argsort(-weights)
        self.rivals = tuple(
            replace(kept[k], probability=float(weights[k] / weights.sum())) for k in order
        )
        self.is_misfit = bool(self._is_known and reduced[order[0]] > FITS)
        if self._is_known and not self.is_misfit:
            self.rivals = tuple(r for r in self.rivals if r.probability > LEAST_LIKELY)

    @property
    def _is_known(self):
        """Whether the noise is."""
        return self.means.noise > 0 or self.means.noise_share > 0

    def _judge(self):
        """What is not settled."""
        left = []
        if not self.rivals:
            left.append("no_law")
        elif self.rivals[0].probability < SURE:
            left.append("rivals")
        if self.rivals and self.is_misfit:
            left.append("misfit")
        elif self.rivals and _is_series(self.rivals[0].law):
            left.append("series")
        self.left = tuple(left)

    def _ask_whole(self, dataset, rng):
        """Close the loop on whole recordings with the likeliest law declared, if there is one."""
        self.says("asking whole recordings what is missing")
        declared = _declared(self.rivals[0].law) if self.rivals else self.declared
        self.report = report = close_loop(
            dataset, declared, rng=rng, progress=self.says, **self.settings
        )
        is_new = any(done.adopted for done in report.rounds)
        if is_new:
            self._take(report)
            self._weigh(dataset)
            self._judge()
        elif report.verdict != "nothing missing":
            self.left = (*self.left, "missing")
        elif self.left in ((), ("unforeseen",)):
            # A law that was made up afterwards fits what it was made from: it must foresee.
            self.left = () if self.is_foretold else ("unforeseen",)
            self.stands = self.is_foretold

    # --- what is kept ----------------------------------------------------------------------------

    def keep(self, number):
        """Write what was seen and is believed; a run that is interrupted goes on from here."""
        if self.out is None:
            return
        self.out.mkdir(parents=True, exist_ok=True)
        content = {
            "schema": "bsp_gp/discovery/1", "round": number, "stands": self.stands,
            "open": list(self.left), "part": self.part, "is_misfit": self.is_misfit,
            "is_at_ends": self.is_at_ends, "n_lost": self.n_lost,
            "longest": self.longest, "experiments": [
                {**e.to_dict(), "seen": _plain(r)}
                for e, r in zip(self.experiments, self.recordings, strict=True)
            ],
            "rivals": [
                {
                    "law": r.text, "probability": r.probability, **law_record(r.law),
                    "uncertain": list(r.names), "covariance": np.asarray(r.covariance).tolist(),
                }
                for r in self.rivals
            ],
        }  # fmt: skip
        with whole_file(self.out / "discovery.json") as part:
            part.write_text(json.dumps(content, indent=1), encoding="utf-8")

    def resume(self):
        """Take up a run that was interrupted; how many rounds it had ended."""
        file = None if self.out is None else self.out / "discovery.json"
        if file is None or not file.exists():
            return 0
        try:
            content = json.loads(file.read_text(encoding="utf-8"))
            for record in content["experiments"]:
                experiment = Experiment.from_dict(record)
                self.add(experiment, _recording(record["seen"]))
            scenes = self.dataset
            self.rivals = tuple(_rival(r, scenes) for r in content["rivals"])
            self.left, self.stands = tuple(content["open"]), content["stands"]
            self.part, self.is_misfit = content["part"], content["is_misfit"]
            self.is_at_ends = content.get("is_at_ends", False)
            self.n_lost, self.longest = content.get("n_lost", 0), content.get("longest", 1.0)
            return int(content["round"])
        except (OSError, ValueError, KeyError, TypeError, LawError) as error:
            raise DataError(f"this is no discovery to go on from ({error})", file=file,
                            remedy="choose another folder") from error  # fmt: skip

    def result(self, number):
        """The discovery."""
        left = self.left
        if self.inseparable and "rivals" in left:
            left = (*left, "inseparable")
        return Discovery(
            self.rivals[0].law if self.rivals else None, self.rivals, self.stands, left,
            self.inseparable, number, tuple(self.experiments), tuple(self.recordings),
            self.dataset if self.experiments else None, self.report,
        )  # fmt: skip


def _scene(name, experiment, recording, means):
    """A recording as a scene; where bodies begin is known, whether or not it was looked at."""
    times, positions = np.asarray(recording.times), np.asarray(recording.positions, dtype=float)
    sigma = recording.sigma
    is_begun = bool(times[0] <= experiment.times[0])
    if not is_begun and not means.position_error:
        begin = np.array([b.position for b in experiment.bodies], dtype=float)
        times = np.concatenate([[experiment.times[0]], times])
        positions = np.concatenate([begin[None], positions])
        sigma = None if sigma is None else np.concatenate([sigma[:1], sigma])
        is_begun = True
    if sigma is None and means.noise_share:
        sigma = means.sigma(positions)
        sigma = np.maximum(sigma, 1e-9 * np.nanmax(np.abs(positions)))
    if sigma is not None and sigma.shape[-1] == 1:
        sigma = np.pad(sigma, ((0, 0), (0, 0), (0, 1)), mode="edge")
    seen = replace(experiment, times=tuple(times.tolist()))
    scene = seen.scene(name, positions, means.errors, sigma)
    return scene if is_begun else replace(scene, first=None)


def _departure(scene):
    """How far forces have led any body off at every row, m, shape (T,)."""
    if scene.first is None:
        return np.zeros(len(scene.times))
    t = (scene.times - scene.times[0])[:, None, None]
    free = scene.positions[0] + np.nan_to_num(scene.first.velocity) * t
    off = np.linalg.norm((scene.positions - free)[:, scene.dynamic], axis=-1)
    return np.nanmax(np.nan_to_num(off), axis=1)


def calm(scene):
    """The first rows of a scene, in which forces have not yet led any body far off.

    Parameters
    ----------
    scene : Scene
        With known first states; others are returned as they are.
    """
    if scene.first is None or len(scene.entities) < 2:
        return scene
    count = n_calm(_departure(scene), nearest(scene.positions, scene.dynamic))
    return scene if count == len(scene.times) else scene.rows(None, max(count, 3))


def _declared(law):
    """A law as it may be declared: all its terms, constants where they are."""
    terms = tuple(replace(t, is_declared=True) for t in law.terms)
    return ForceLaw(terms, law.constants, law.frame)


def _is_series(law):
    """Whether many terms of a law act along one direction: they may stand for any other form."""
    ways = []
    for term in law.terms:
        above, _ = factors(split_linear(term.formula)[1])
        ways += [to_text(f) for f in above if f.type.shape == "vector"]
    return any(ways.count(way) > MOST_ALONG for way in ways)


def _fitted(rival, found):
    """A rival with the constants of a fit."""
    names, covariance = found.uncertain
    return replace(rival, law=found.law, names=names, covariance=covariance)


def _final(report):
    """The law that a report ends with, as a rival."""
    law = in_common(report.law)
    rival = Rival(law.text(digits=False), law, 1.0)
    return _fitted(rival, report.fit) if law is report.law else rival


def _rival(record, dataset):
    law = read_law(dataset, [t["text"] for t in record["terms"]])
    law = law.with_constants({k: v for k, v in record["values"].items() if k in law.names})
    count = len(record["uncertain"])
    covariance = np.array(record["covariance"], float).reshape(count, count)
    return Rival(record["law"], law, record["probability"], tuple(record["uncertain"]), covariance)


def _plain(recording):
    out = {"times": np.asarray(recording.times).tolist(),
           "positions": np.asarray(recording.positions).tolist()}  # fmt: skip
    if recording.sigma is not None:
        out["sigma"] = np.asarray(recording.sigma).tolist()
    return out


def _recording(record):
    sigma = record.get("sigma")
    return Recording(np.array(record["times"]), np.array(record["positions"], dtype=float),
                     None if sigma is None else np.array(sigma, dtype=float))  # fmt: skip
