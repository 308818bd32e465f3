"""Case bundles: a folder with the inputs of one region and period, how one is made, read, cut at a time and scored."""
