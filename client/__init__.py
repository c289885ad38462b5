"""`cs3d`: validate and evaluate offline, submit and watch online."""
