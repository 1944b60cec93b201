"""What the codes of the loop mean in words: the one place where a code becomes a sentence."""

CAUSES = {
    "exponent": "another exponent", "number": "another number", "period": "a push with a period",
    "ripple": "a force that repeats along an axis", "pulsing": "a strength with a period",
    "growing": "a strength that grows or fades",
    "delayed": "a force that acts late",
    "wind": "a medium that moves (a wind, a current)",
    "belt": "a ground that moves under the bodies (a belt)",
    "constant_per_body": "a constant for each body",
    "constant_per_scene": "a constant for each scene",
    "shape": "a force that is a function of one variable, bred on these data",
    "law_by_body": "a force of another strength for each body",
    "law_by_scene": "a force of another strength in each scene",
    "law_by_source": "a force between bodies, each of which acts by a strength of its own",
    "gravity": "gravity of bodies whose masses are not known",
    "scale": "a wrong scale of lengths", "clock": "a clock that runs wrong",
    "tilt": "a camera that is turned", "zero": "an angle whose zero is off",
    "pivot": "angles about a point beside the pivot", "slant": "a picture plane that is tilted",
    "drift": "a camera that drifts, or what rests in the law", "offset": "an origin that is off",
    "origin": "an origin beside what a body is held to",
    "length": "a length other than was typed",
    "delay": "a delay of one body", "exposure": "an exposure that blurs",
    "shutter": "a shutter that reads the picture row by row",
    "inclined": "an orbit whose plane is inclined to the sky", "late_log": "a log that is late",
    "lens": "a lens that distorts", "perspective": "perspective",
    "decentred": "a lens that distorts, off the middle of the picture",
    "zoom": "a camera that zooms",
    "swapped_tracks": "tracks that are swapped", "lost_track": "a track that is lost",
    "untrimmed": "rows before a body is let go, or after its motion has ended",
    "bad_row": "a bad row", "clock_jump": "times that are off from a row on",
    "hidden_body": "an unseen body", "orbit": "an unseen companion",
    "trend": "a velocity that changes steadily, as a companion far out makes it",
    "bent_trend": "a velocity that changes at a changing rate, as a companion far out makes it",
    "contact": "a contact",
    "collision": "a collision",
    "bounce": "a floor or wall that it bounces off",
    "rod": "a distance that stays constant: a string or rod",
    "rods": "bodies on rods that hang from one another",
    "wire": "a line, curve or plane that is kept to: a wire or rail",
    "frame": "a frame that turns: Coriolis and centrifugal forces",
    "reference": "the acceleration of the body from which places count",
    "kicks": "random kicks", "noise": "noise with a memory from row to row",
    "varying_strength": "a strength that varies, of no listed form",
    "free_force": "a force of no listed form",
}  # fmt: skip
OWN_STRENGTHS = {
    "law_by_body": "of another strength for each body",
    "law_by_scene": "of another strength in each scene",
    "law_by_source": "each body acting by a strength of its own",
    "gravity": "by masses that it tells",
}
"""What is said behind the name of a force."""
KINDS = {
    "pair": "force between bodies", "field": "force on each body by itself",
    "hidden_body": "unseen body", "kicks": "random kicks",
    "measurement": "measurement", "constraint": "constraint", "wall": "floor or wall",
    "declared_term_change": "change of a declared term", "noise": "noise",
}  # fmt: skip
FINDINGS = {
    "hidden_body": "{} acts on these",
    "kicks": "{} act on these",
    "constraint": "what moves is held ({})",
    "wall": "what moves meets {}",
    "inclined": "this is {}",
    "orbit": "this star goes round with {}", "trend": "this star has {}",
    "bent_trend": "this star has {}",
    "origin": "places count from beside what holds a body",
    "length": "a body is held at another length than was typed",
    "measurement": "the measurement distorts the motion ({})",
    "declared_term_change": "a declared term has to change ({})",
    "noise": "the noise is not as it was assumed ({})",
}
"""What was adopted, by its code or else its kind."""
REASONS = {
    "adopted": "it is significant, likelier than all else, and borne out by scenes left out",
    "not_significant": "noise alone shows as much as the best of everything that was tried",
    "no_better_than_before": "it is no likelier than the model without it",
    "kinds_tie": "a cause of another kind is as likely",
    "held_out_refuses": "scenes that were left out do not gain what it promises",
    "predictions_worse": "predictions of what was held out get surely worse with it",
    "predictions_no_better": "more is left beside it, and predictions of what was held out get no "
    "better with it",
    "no_candidate_fits": "nothing that was tried could be fitted",
    "not_tested": "what is left could not be tested",
    "declared_model_not_fitted": "the declared model could not be fitted to the tracks",
    "noise_explains": "noise of another kind explains it as well as any force",
    "time_is_up": "the time was up before everything was looked at",
    "superseded": "what was found later made it superfluous",
    "beside_description": "it makes up for a law beside it that only describes these tracks",
    "force_beside": "it describes these tracks, but more of no listed form is left beside it",
    "many_causes": "it takes many causes to describe these tracks, rather than one of another form",
    "not_placed": "its strength may be nothing, and it may be anywhere: other pushes that change "
    "from place to place do as well",
    "much_left": "much of the motion is left beside it, which nothing that was tried explains",
    "more_left": "more than noise is left beside it that nothing explains: it may be the nearest "
    "of what was tried",
    "laboratory": "it acts along the axes of a picture, or about a place where nothing is seen, as "
    "nothing in the sky does",
    "open_powers": "several forces of which these data do not tell the powers follow any curve",
    "smooth_kicks": "kicks so slight that many rows pass until one shows: a force that changes "
    "smoothly from place to place, or in time, moves the bodies as well",
    "bred": "its form is no listed one: it was bred on these data, and others may do as well",
    "another_power": "a power in it is surely another than is written: the force has another form",
    "poorly_foreseen": "it describes the tracks that it was found in, but predictions of what was "
    "held out are no better with it, though so few rows do not refuse it for sure",
    "undetermined": "it describes these tracks, but each of its strengths may be nothing: they are "
    "several forces of which these data tell the sum",
    "at_bound": "a constant inside it ends at the bound of what it may be: another form is asked "
    "for",
    "few_periods": "no recording is so long that it was seen to come back, and what does not may "
    "be several, or of another form",
    "own_period": "its period is about that of the swing itself, or a part of it: whatever the law "
    "lacks otherwise looks like that",
    "odd_power": "a power that is no whole or half number, and a steady push beside it, follow "
    "many a curve",
    "passage": "it describes these tracks, but nothing in the sky is kicked: it stands for a "
    "passage of some body, or a burn",
    "season": "a period is that of the Earth's year, half of it or its day: what these do to "
    "instruments, and to when stars are seen, comes back as a companion would",
    "alias": "whoever looks at a star once a night cannot tell its period from another, whose rate "
    "is less or more by a turn a day",
    "held_out_disagrees": "it describes the tracks that it was found in, but what was held out "
    "does not follow it within the noise",
    "likelier_refused": "what is likelier on the tracks in which laws are looked for makes "
    "predictions of what was held out no better; of the others this is one with which they are",
    "noise_likelier": "noise with a memory is as likely on the tracks in which laws are looked "
    "for; but it foresees nothing, and this does",
    "strength_varies": "it describes these tracks, but its strength is not the same everywhere",
    "slight": "what is left is little, and it takes up less than half of that and leaves more than "
    "noise: so do lenses, clocks and bobs that leave their plane",
    "swamped": "nothing that was tried explains the motion, and what is left of it is too large to "
    "be an error of the measurement",
}
STOPS = {
    "nothing_left": "nothing is left above the noise",
    "nothing_adopted": "nothing more was good enough to adopt",
    "many_causes": "so many causes only describe these tracks: no more were asked for",
    "most_rounds": "the limit of rounds was reached; more may be left",
    "time_is_up": "the time was up",
    "failed": "the declared model could not be fitted",
}
LEFT_OUT = {
    "rows": "causes were looked for in a part of the rows only",
    "proposers": "some kinds of causes were not looked for",
    "fits": "some causes were not fitted",
    "held_out": "what acts in held-out scenes alone was not looked for",
    "removal": "what became superfluous was not taken back",
    "intervals": "neither the noise floor nor all intervals were found out",
    "errors": "errors on what is held out were not found out",
}
METHODS = {
    "parametric": "simulated copies of the held-out scenes, of which there are fewer than five",
    "resampled": "resampling whole held-out scenes", "none": "",
}  # fmt: skip
NOISE = {
    "size": "it is of another size than declared or quoted",
    "autocorrelation": "it has a memory from row to row",
    "tails": "it has heavier tails than a normal distribution",
    "common": "it is much the same for all bodies at a time, as where a camera shakes",
    "level_of_scene": "its level differs from scene to scene",
    "level_of_body": "its level differs from body to body",
    "level_with_speed": "it grows with the speed",
    "grid": "positions lie on a grid that is as coarse as the noise",
    "row": "a single row is far off",
}
"""What may be found of the noise."""
DIRECTIONS = {
    "along": "along the velocity", "across": "across the velocity",
    **{f"across_{axis}": f"across the velocity and {axis}" for axis in "xyz"},
    "line": "along the lines to the other bodies",
}  # fmt: skip
VARIABLES = {
    "time": "time", "speed": "speed", "distance": "distance", "body": "the body",
    "scene": "the scene",
}  # fmt: skip
TONES = {
    "effect adopted": "found", "effective law": "found", "the noise is not as assumed": "open",
    "nothing missing": "clean", "seen, not adopted": "open", "cannot tell": "open",
}  # fmt: skip
"""In what tone a verdict is shown."""
