"""The recipe: a proposer gives candidates, `finish` makes of each a certified grasp or a reason."""
