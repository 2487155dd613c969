"""A person's hand in, any hand out: key points of a camera or a glove to joint values, by kinematics alone."""
