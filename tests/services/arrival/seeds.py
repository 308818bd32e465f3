"""Seeds of the synthetic fires, in disjoint ranges: nothing tuned on one range is judged on it."""

TUNING = range(1000, 1100)
TESTS = range(2000, 2100)
BENCH = range(3000, 3100)
# What the correction of the fitted field is learned from: fires of many kinds, and small ones.
TRAINING = range(10_000, 40_000)
TRAINING_SMALL = range(40_000, 60_000)
