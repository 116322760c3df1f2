"""Studies with observers: their design, their stimuli, how they are run, and their analysis."""
