"""Objects, their convex parts and distances, how they rest on the table, and the plant that holds them."""
