"""Every level on which a verdict depends, and the closed lists of codes that are told."""

from dataclasses import dataclass

VERDICTS = (
    "effect adopted", "effective law", "seen, not adopted", "the noise is not as assumed",
    "cannot tell", "nothing missing",
)  # fmt: skip
"""In the order of precedence in which a report takes that of its rounds."""
REASONS = (
    "adopted", "not_significant", "no_better_than_before", "kinds_tie", "held_out_refuses",
    "predictions_worse", "predictions_no_better", "no_candidate_fits",
    "declared_model_not_fitted", "noise_explains", "time_is_up", "superseded", "not_tested",
    "strength_varies", "beside_description", "force_beside", "held_out_disagrees",
    "many_causes", "own_period", "few_periods", "likelier_refused", "noise_likelier",
    "not_placed",
    "swamped", "slight", "at_bound", "much_left", "more_left", "laboratory", "poorly_foreseen",
    "smooth_kicks", "open_powers", "another_power", "odd_power", "season",
    "alias", "passage", "undetermined", "bred",
)  # fmt: skip
"""Why a round ended as it did; "superseded": adopted, and taken back by backward removal;
"strength_varies": adopted as a description, since its constant is not the same everywhere;
"beside_description": found beside such a one; "force_beside": a force that knows no physics beside
it is likelier than none; "held_out_disagrees": what was held out leaves more than noise beside it,
whatever its numbers; "many_causes": more of them than are likely to be missing; "own_period": a
push that has the period of the swing without it; "few_periods": one that was not seen to come
back; "likelier_refused": adopted in the place of a likelier one that made predictions no better;
"noise_likelier": the same of noise, which foresees nothing;
"not_placed": an unseen body whose strength may be nothing; "swamped": noise with a memory would
explain it, as large as the motion; "slight": it takes up less than half of the little that is
left; "time_is_up": of what there was time for it is the likeliest, and leaves little;
"at_bound": a constant inside it ends at its bound; "much_left": a third of the motion and more is
left beside it; "more_left": surely more than noise is; "laboratory": it acts along axes, or about
a place, in the sky; "poorly_foreseen": predictions are notably off with it, or no better where
they say little, though not surely worse; "smooth_kicks": random kicks so slight that a force which
changes smoothly is as likely; "open_powers": several forces of which the data do not tell a power;
"another_power": one that the data surely tell is another; "odd_power": one that is no multiple of a
half, beside a steady push; "season": orbits of which one has the period of the Earth's year or day;
"alias": or one that looks alike to who looks once a day;
"passage": a velocity that jumps in the sky; "undetermined": each of its strengths may be nothing
(several forces of which the data tell the sum); "bred": a function that was bred on these data."""
LEFT_OUT = ("rows", "proposers", "fits", "held_out", "removal", "intervals", "errors")
"""What a time limit can leave undone."""
STOP_REASONS = (
    "nothing_left", "nothing_adopted", "most_rounds", "many_causes", "time_is_up", "failed",
)  # fmt: skip
CAUSES = (
    "law", "shape", "law_by_body", "law_by_scene", "law_by_source", "gravity", "exponent", "number",
    "constant_per_body", "constant_per_scene", "period", "ripple", "pulsing", "growing",
    "delayed", "wind", "belt", "scale", "clock", "tilt", "zero", "pivot", "slant", "drift",
    "offset", "origin", "length", "delay", "exposure", "lens", "decentred", "zoom", "shutter",
    "perspective", "inclined", "late_log", "swapped_tracks", "lost_track", "untrimmed", "bad_row",
    "clock_jump", "hidden_body", "orbit", "trend", "bent_trend", "contact", "collision", "bounce",
    "rod", "rods", "wire", "frame", "reference", "kicks", "noise", "varying_strength",
    "free_force",
)  # fmt: skip
"""What a hypothesis adds; the last two know no physics: none of these."""
CHANGES = (
    "exponent", "number", "pulsing", "growing", "delayed", "wind", "belt", "constant_per_body",
    "constant_per_scene",
)  # fmt: skip
"""Codes of causes that change a term of the law."""
KICKED = ("contact", "collision")
"""Codes of what is over in an instant: a body that is kicked, two that kick each other."""
KINDS = ("force", "constraint", "wall", "measurement", "hidden_body", "kicks", "noise")
"""What kind of thing that is: kinds that tie are not told apart."""
FORESEEING = ("force", "constraint", "wall", "hidden_body")
"""Kinds of causes that act on what was held out as well; errors of the measurement need not."""
NOISE_FINDINGS = (
    "size", "autocorrelation", "tails", "common", "level_of_scene", "level_of_body",
    "level_with_speed", "grid", "row",
)  # fmt: skip
"""In what noise may not be as assumed."""


@dataclass(frozen=True)
class Criteria:
    """Levels that can change a verdict.

    Attributes
    ----------
    alpha : float
        Chance of calling something missing where nothing is, selection counted.
    separation : float
        Chi-squared by which a rival form must lie above the best for the best to be a fact: four
        standard deviations. A rule that keeps 95 % of true forms would state a form that is one
        standard deviation away as a fact in 83 % of its sets.
    class_nats : float
        Rivals are told whose log posterior is within this of the best, and proposals fitted to
        whole tracks whose promise is.
    most_fits : int
        Proposals that are fitted in a round at the most.
    effort : int
        Steps within which the fit of a proposal must converge: tens to hundreds where it is right,
        thousands on exact data.
    tie_nats : float
        Odds within which an error of the measurement and a force are not told apart; rivals whose
        log evidence is within twice that of the best are told as well.
    sure : float
        Probability, beside causes that nobody lists, from which a form is a fact.
    unknown_nats : float
        Log odds, beforehand, against each kind of those: a strength that varies, a free force.
    noise_nats : float
        Odds by which a cause must be likelier than noise of another kind.
    promise : float
        Part of the gain that a hypothesis promises for held-out tracks, which it must keep.
    constant_within : float
        Part of its strength by which a law that was found may change from place to place, surely,
        and be a law: some weaker effect beside it always shows where the noise is low.
    power_step : float
        Powers of speed and distance so far from the one that is stated must be excluded.
    cause_nats : float
        Log odds, beforehand, against a cause that is no law of the grammar: as likely as the
        simplest laws.
    decades : float
        A strength is as likely in every factor of ten over so many of them.
    exponent_width : float
        Standard deviation of an exponent about the one that was declared.
    """

    alpha: float = 0.01
    separation: float = 16.0
    class_nats: float = 8.0
    most_fits: int = 12
    effort: int = 600
    tie_nats: float = 2.0
    sure: float = 0.7
    unknown_nats: float = 1.6
    noise_nats: float = 3.0
    promise: float = 0.3
    constant_within: float = 0.05
    power_step: float = 0.5
    cause_nats: float = 3.0
    decades: float = 3.0
    exponent_width: float = 2.0
