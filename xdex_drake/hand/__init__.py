"""What a hand is: description, library, files, kinematics, spheres, collision pairs, Drake plant."""
