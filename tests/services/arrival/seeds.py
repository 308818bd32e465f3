"""Seeds of the synthetic fires, in disjoint ranges: nothing tuned on one range is judged on it."""

TUNING = range(1000, 1100)
TESTS = range(2000, 2100)
BENCH = range(3000, 3100)
