C     Von Mises' plasticity with linear hardening, radial return.
C     PROPS: E (Pa), nu, yield stress (Pa), hardening (Pa).
C     STATEV: accumulated plastic strain.
C     Simo & Hughes, Computational Inelasticity (1998), box 3.2.
      SUBROUTINE UMAT(STRESS,STATEV,DDSDDE,SSE,SPD,SCD,RPL,DDSDDT,
     1 DRPLDE,DRPLDT,STRAN,DSTRAN,TIME,DTIME,TEMP,DTEMP,PREDEF,DPRED,
     2 CMNAME,NDI,NSHR,NTENS,NSTATV,PROPS,NPROPS,COORDS,DROT,PNEWDT,
     3 CELENT,DFGRD0,DFGRD1,NOEL,NPT,LAYER,KSPT,JSTEP,KINC)
      INCLUDE 'ABA_PARAM.INC'
      CHARACTER*80 CMNAME
      DIMENSION STRESS(NTENS),STATEV(NSTATV),DDSDDE(NTENS,NTENS),
     1 DDSDDT(NTENS),DRPLDE(NTENS),STRAN(NTENS),DSTRAN(NTENS),TIME(2),
     2 PREDEF(1),DPRED(1),PROPS(NPROPS),COORDS(3),DROT(3,3),
     3 DFGRD0(3,3),DFGRD1(3,3),JSTEP(4)
      DIMENSION S(6),HALF(6)
      E = PROPS(1)
      ANU = PROPS(2)
      G = 0.5D0*E/(1D0 + ANU)
      BULK = E/(3D0*(1D0 - 2D0*ANU))
      ALAM = BULK - 2D0/3D0*G
      EV = DSTRAN(1) + DSTRAN(2) + DSTRAN(3)
      DO I = 1, 3
        STRESS(I) = STRESS(I) + ALAM*EV + 2D0*G*DSTRAN(I)
      END DO
      DO I = 4, NTENS
        STRESS(I) = STRESS(I) + G*DSTRAN(I)
      END DO
      P = (STRESS(1) + STRESS(2) + STRESS(3))/3D0
      Q2 = 0D0
      DO I = 1, 3
        S(I) = STRESS(I) - P
        HALF(I) = 1D0
        Q2 = Q2 + S(I)*S(I)
      END DO
      DO I = 4, NTENS
        S(I) = STRESS(I)
        HALF(I) = 0.5D0
        Q2 = Q2 + 2D0*S(I)*S(I)
      END DO
      Q = SQRT(1.5D0*Q2)
      SY = PROPS(3) + PROPS(4)*STATEV(1)
      F = Q - SY
      SHRINK = 1D0
      ALONG = 0D0
      IF (F .GT. 0D0) THEN
        DGAM = F/(3D0*G + PROPS(4))
        STATEV(1) = STATEV(1) + DGAM
        SPD = SPD + DGAM*(SY + PROPS(4)*DGAM)
        SHRINK = 1D0 - 3D0*G*DGAM/Q
        DO I = 1, 3
          STRESS(I) = P + SHRINK*S(I)
        END DO
        DO I = 4, NTENS
          STRESS(I) = SHRINK*S(I)
        END DO
C       (2G)^2 times 3/2 (dgamma/q - 1/(3G + H)), per q^2, on s s
        ALONG = 6D0*G*G*(DGAM/Q - 1D0/(3D0*G + PROPS(4)))*1.5D0/(Q*Q)
      END IF
      SOFT = 2D0*G*SHRINK
      DO J = 1, NTENS
        DO I = 1, NTENS
          DDSDDE(I,J) = ALONG*S(I)*S(J)
        END DO
        DDSDDE(J,J) = DDSDDE(J,J) + SOFT*HALF(J)
      END DO
      DO J = 1, 3
        DO I = 1, 3
          DDSDDE(I,J) = DDSDDE(I,J) + BULK - SOFT/3D0
        END DO
      END DO
      SSE = 0.5D0*P*P/BULK + (SHRINK*Q)**2/(6D0*G)
      RETURN
      END
