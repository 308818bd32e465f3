"""Burned area: labels, training, the classifier, its products."""
