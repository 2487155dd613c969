"""The models: one file a model, built from the layers."""
