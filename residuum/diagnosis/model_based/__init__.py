"""A machine that has a model is watched by it: what is healthy is learned, a window judged, and its
cause named by simulation.
"""
