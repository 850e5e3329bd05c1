"""Numbers that decide what a diagnosis says of a driven machine: which effects are named, which tie, and the verdict.

What each does to the answers stands in docs/ablation.md. Numbers of estimation and of numerics, and how much is tried,
stand where they are used.
"""

# evidence for one of two hypotheses
SURE = 3.0
"""Logarithm of the likelihood ratio (20 to 1) from which on one of two hypotheses is the better one."""
NAMED = 4.0
"""Deviations by which a contrast of an effect's parameters must differ from where the effect vanishes."""
MOVES = 0.02
"""Share of the nominal error by which a further effect must move predictions; less is detail of what is known
(friction law, timestep, integrator), which a wrong effect can imitate."""
INDIRECT = 0.75
"""Directions that a tier counts for where candidates tie: the more direct explanation is the simpler one."""

# how long a search goes on
AT_NOISE = 1.1
"""Mean loss up to which nothing is missing."""
SETTLED = 1.25
"""Mean loss up to which no more is asked: of laws of friction that contain a plain one, and of a model as given that
strikes something."""
LOUD = 1.5
"""Mean loss at one degree of freedom beyond which something may be missing there."""
ORDINARY, OUTLYING, CLEARLY, SEVERAL = 1.15, 8.0, 0.5, 3
"""Median loss where all but a few windows show noise alone; deviations from it, and relative chi^2, by which a window
stands out at least; and how many such windows are no accident."""
HOPELESS = 0.06
"""Share of the loss of one joint that a second effect must take away in screening to be looked at further."""
HALF_AS_GOOD, FAMILIES = 0.5, 3
"""Share of what the best candidate explains from which on others are fitted further, and families of candidates of
which the best one always is."""
AFTER, REMAINS = 3, 0.5
"""Effects that the search has found, or degrees of freedom that still lack something, at which effects in every joint
are tried; and the share of the squared error that may remain with them, with one unknown force in place of all that
was named, or with functions that are what it depends on."""
WEAKEST = 6
"""Terms that are tried without at a time: those that the data determine worst."""
ELSEWHERE = 2
"""Other places at which an effect was found from which on it is likely at a further one too: there it need not be shown
beyond doubt, but differ clearly from nothing."""
EXCHANGES = 2
"""Terms that may be exchanged for better ones once the whole hypothesis is known."""
RICHER = 2
"""Elaborate laws in place of one plain one that are fitted to all windows."""
ENOUGH_WINDOWS = 8
"""Windows that it takes to look once more, in longer ones, and to give up what has a name for what has none."""

# more than noise
DOUBT = 3.0
"""Standard errors by which the mean loss must exceed what noise leaves for something to be left."""
BEYOND_NOISE, BY_CHANCE = 2.0, 2.5
"""Times the largest loss of any window that noise leaves, by simulation, beyond which no noise explains one; and that
loss where recordings are too short to be simulated anew: of windows of few rows."""
ELSEWHERE_FROM, MANY_ELSEWHERE = 1.3, 0.5
"""Relative chi^2 of a window from which on it may start elsewhere than estimated, where things strike each other; and
the share of such windows from which on something is missing instead."""

# what is no physics
SEEN, MOST_SEEN = 6.0, 3.0
"""Deviations from nothing at which another timestep, integrator or moment of the commands than the model's counts as
seen, and how many of those that whitening allows for it may be."""

# whether an effect adds to the force that is missing
SURELY, LARGER, USUALLY = 3.0, 2.0, 0.5
"""Standard errors from which on a force is missing in a window; how many times as large with the effect as without it
it must be; and the share of the windows from which on that is the usual case."""

# the verdict
FAR = 10.0
"""Times what noise and other steps than the model's leave from which on an error is not nothing, whatever the search
found: twice as far as starts may be known worse than they are said to be."""
SLIGHT = 0.02
"""Share of the squared error up to which what is left is told beside the effects and does not change the verdict."""
MEANS_SOMETHING = 2.0
"""How many times the noise a window's error must be to mean anything: the usual one's for the share that is left, and
any one's where effects are confirmed by errors in units of the noise, and that of all together for a search beside what
has no name."""
