"""The path of least energy at any angle: a grid search says where it may lie, one more search among line points finds
it there, and its vertices are then moved to the least energy nearby.
"""
