"""Where a gap lies: the axes, their shares and the null bank."""
