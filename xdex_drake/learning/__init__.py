"""The generative model: networks, training, checkpoints, prediction. `features` and `heading` do without torch."""
