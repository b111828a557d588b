"""What made one figure of the documents each. Nothing else of the lab imports these modules."""
