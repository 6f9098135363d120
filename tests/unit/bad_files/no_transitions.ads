M

State size:
1

Marker states:

Vocal states:
