"""§5, the Beta Shape Machine: P_bsm(D, H, G, E) over corresponding points and the existence of parts.

Read in this order: ``observations`` (what the machine sees), ``machine`` (Eq. 2 in natural centred form), ``energy``
and ``paper_form`` (Eq. 2 for tests, and as printed), ``inference`` (mean field), ``pretraining`` and ``finetuning``
(one step of each), ``priors`` (of the weights), ``learning`` (the loop), ``structure`` (which parts exist), ``draw``
(new shapes), ``evidence`` (new shapes that agree with what is known), ``units`` (what is worth a slider), ``joint``
(the machine as a prior of the fit), ``descriptors``, ``transformer`` (these for scikit-learn), ``curve`` (would more
shapes help?), ``baselines`` and ``gaussian`` (what it is compared with).
"""
