"""Simulation: pre-grasp and squeeze, and the lift that validates a grasp."""
