"""What several extras share: readers of recorded flights, definitions of messages, foreign numbers, frames on Earth."""
