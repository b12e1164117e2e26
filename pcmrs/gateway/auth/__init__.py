"""Who a signed command is from, and that it is not sent twice."""
