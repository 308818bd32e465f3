"""The three days of the paper's case study: real fires and what is not to be had of those days simulated and marked."""
