"""Structure once, numbers often: the pattern of A, the blocks of A'A, elimination orders, supernodes, the inverse.

Imports nothing of `nls` but `nls.values`.
"""
