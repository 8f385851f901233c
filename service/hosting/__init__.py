"""What a service needs of its machine: settings, memory, priorities, turns."""
