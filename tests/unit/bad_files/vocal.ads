M

State size:
1

Marker states:
0

Vocal states:
0 10

Transitions:

