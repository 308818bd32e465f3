"""The live case: bundles made of what was fetched from providers, one for each cycle, frozen once they are made."""
