"""The probabilistic deformation model (§4): part templates, and through them correspondences and segmentations.

``fit`` is Algorithm 1 as an iterator of states; ``updates`` are the mean-field steps it is made of, ``factors`` and
``energy`` what they descend on, ``existence`` which parts a shape has; ``hierarchy`` links the groups' templates into
one family by ``registration``, over ``levels`` in between where it must; ``faces`` takes labels from points to faces,
``boxes`` proposes parts where nothing was painted, ``apply`` fits new shapes.
"""
