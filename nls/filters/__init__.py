"""Recursive estimators fed with the factors of a graph: a step a pose, what was measured up to it and nothing later.

Every filter takes h, its Jacobians, the noise and the differences of angles from the factors, so that one data set, one
`FactorGraph`, serves a filter and a batch solution alike.
"""
