"""What several extras share: log readers, definitions of messages, MAVLink frames, foreign numbers, frames on Earth."""
