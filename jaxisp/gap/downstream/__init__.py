"""What denoisers gain by the effects found, and what flexible models reach."""
