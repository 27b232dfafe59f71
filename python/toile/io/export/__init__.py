"""Clips as other programs read them: one writer a format. `source` opens clips of runs and animations.

Every writer keeps the order of vertices and faces. What stands under the asked name is whole.
"""
