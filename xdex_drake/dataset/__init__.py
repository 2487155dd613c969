"""Files of grasps and data set folders: schema, store, generation and executors."""
