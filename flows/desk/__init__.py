"""The desk where people decide: approvals of plans, and targets that a person adds, pins, excludes or re-weights."""
