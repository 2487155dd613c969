"""The workshop: units of work in processes, in order, and the jobs that make many grasps and count."""
