"""From any robot file to a hand: readers bring a file into one form (`model`), and `interpret` finds the hand in it."""
